"""SimOTA label assignment and the losses of YOLOX (Ge et al. 2021, section 2.1)."""

import torch
import torch.nn.functional as F

from .yolox import decode, flatten


def pairwise_iou(a, b):
    """IoU of every box in `a` (N x 4) with every box in `b` (M x 4), both cx, cy, w, h."""
    low = torch.maximum(a[:, None, :2] - a[:, None, 2:] / 2, b[None, :, :2] - b[None, :, 2:] / 2)
    high = torch.minimum(a[:, None, :2] + a[:, None, 2:] / 2, b[None, :, :2] + b[None, :, 2:] / 2)
    both = (high - low).clamp(min=0).prod(2)
    return both / (a[:, 2:].prod(1)[:, None] + b[:, 2:].prod(1)[None] - both + 1e-9)


def giou_loss(a, b):
    """1 - generalised IoU (Rezatofighi et al. 2019), row by row."""
    low, high = a[:, :2] - a[:, 2:] / 2, a[:, :2] + a[:, 2:] / 2
    low_b, high_b = b[:, :2] - b[:, 2:] / 2, b[:, :2] + b[:, 2:] / 2
    both = (torch.minimum(high, high_b) - torch.maximum(low, low_b)).clamp(min=0).prod(1)
    union = a[:, 2:].prod(1) + b[:, 2:].prod(1) - both
    hull = (torch.maximum(high, high_b) - torch.minimum(low, low_b)).prod(1)
    return 1 - both / (union + 1e-9) + (hull - union) / (hull + 1e-9)


@torch.no_grad()
def sim_ota(boxes, objectness, kinds, centres, stride, truth_boxes, truth_kinds, top=10):
    """Which rows learn which truth: (row numbers, truth numbers, IoU of each pair)."""
    distance = (centres[:, None] - truth_boxes[None, :, :2]).abs()
    in_centre = (distance < 2.5 * stride[:, None, None]).all(2)
    in_box = (distance < truth_boxes[None, :, 2:] / 2).all(2)
    rows = (in_centre | in_box).any(1).nonzero().squeeze(1)
    if rows.numel() == 0:
        empty = torch.zeros(0, dtype=torch.long)
        return empty, empty, torch.zeros(0)
    iou = pairwise_iou(boxes[rows], truth_boxes)
    score = (kinds[rows].sigmoid() * objectness[rows].sigmoid()[:, None]).sqrt().clamp(1e-6, 1 - 1e-6)
    # Binary cross-entropy against the one-hot class of each truth, without a rows x truths x classes tensor.
    background = -torch.log1p(-score)
    kind_cost = background.sum(1, keepdim=True) - background[:, truth_kinds] - score.log()[:, truth_kinds]
    cost = kind_cost - 3.0 * (iou + 1e-8).log() + 1e5 * (~(in_centre & in_box)[rows])
    chosen = torch.zeros_like(cost, dtype=torch.bool)
    count = iou.topk(min(top, len(rows)), 0).values.sum(0).int().clamp(min=1)
    for t in range(len(truth_boxes)):
        chosen[cost[:, t].topk(min(int(count[t]), len(rows)), largest=False).indices, t] = True
    crowded = chosen.sum(1) > 1
    if crowded.any():
        best = cost[crowded].argmin(1)
        chosen[crowded] = False
        chosen[crowded, best] = True
    hit = chosen.any(1)
    truth = chosen[hit].int().argmax(1)
    return rows[hit], truth, iou[hit, truth]


def loss(levels, truths, l1=False):
    """Mean loss per assigned row. `truths`: per image a tensor K x 5 of class, cx, cy, w, h in input pixels."""
    raw, grid, stride = flatten(levels)
    boxes = decode(raw[..., :4], grid, stride)
    centres = (grid + 0.5) * stride[:, None]
    object_target = torch.zeros_like(raw[..., 4])
    box_loss = kind_loss = l1_loss = raw.sum() * 0
    assigned = 0
    for i, truth in enumerate(truths):
        if len(truth) == 0:
            continue
        kinds = truth[:, 0].long()
        rows, which, iou = sim_ota(boxes[i].detach(), raw[i, :, 4].detach(), raw[i, :, 5:].detach(), centres, stride, truth[:, 1:], kinds)
        if rows.numel() == 0:
            continue
        assigned += len(rows)
        object_target[i, rows] = 1.0
        target = truth[which, 1:]
        box_loss = box_loss + giou_loss(boxes[i, rows], target).sum()
        wanted = F.one_hot(kinds[which], raw.shape[2] - 5).to(raw) * iou[:, None]
        kind_loss = kind_loss + F.binary_cross_entropy_with_logits(raw[i, rows, 5:], wanted, reduction="sum")
        if l1:
            s = stride[rows, None]
            exact = torch.cat((target[:, :2] / s - grid[rows], (target[:, 2:] / s + 1e-8).log()), 1)
            l1_loss = l1_loss + (raw[i, rows, :4] - exact).abs().sum()
    object_loss = F.binary_cross_entropy_with_logits(raw[..., 4], object_target, reduction="sum")
    return (5.0 * box_loss + object_loss + kind_loss + l1_loss) / max(assigned, 1)
