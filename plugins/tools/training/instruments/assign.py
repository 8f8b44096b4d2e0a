"""SimOTA label assignment and the losses of YOLOX (Ge et al. 2021, section 2.1)."""

import torch
import torch.nn.functional as F

from .yolox import decode, flatten


def pairwise_iou(a, b):
    """IoU of every box in `a` (... x N x 4) with every box in `b` (... x M x 4), both cx, cy, w, h."""
    a, b = a[..., :, None, :], b[..., None, :, :]
    low = torch.maximum(a[..., :2] - a[..., 2:] / 2, b[..., :2] - b[..., 2:] / 2)
    high = torch.minimum(a[..., :2] + a[..., 2:] / 2, b[..., :2] + b[..., 2:] / 2)
    both = (high - low).clamp(min=0).prod(-1)
    return both / (a[..., 2:].prod(-1) + b[..., 2:].prod(-1) - both + 1e-9)


def giou_loss(a, b):
    """1 - generalised IoU (Rezatofighi et al. 2019), row by row."""
    low, high = a[:, :2] - a[:, 2:] / 2, a[:, :2] + a[:, 2:] / 2
    low_b, high_b = b[:, :2] - b[:, 2:] / 2, b[:, :2] + b[:, 2:] / 2
    both = (torch.minimum(high, high_b) - torch.maximum(low, low_b)).clamp(min=0).prod(1)
    union = a[:, 2:].prod(1) + b[:, 2:].prod(1) - both
    hull = (torch.maximum(high, high_b) - torch.minimum(low, low_b)).prod(1)
    return 1 - both / (union + 1e-9) + (hull - union) / (hull + 1e-9)


def padded(truths, device=None):
    """Truths of B pictures, each K x 5 of class, cx, cy, w, h, as one B x T x 5 tensor, and which of its rows are there (B x T)."""
    most = max(1, max((len(t) for t in truths), default=1))
    rows, present = torch.zeros(len(truths), most, 5), torch.zeros(len(truths), most, dtype=torch.bool)
    for i, truth in enumerate(truths):
        rows[i, : len(truth)], present[i, : len(truth)] = truth, True
    return rows.to(device), present.to(device)


@torch.no_grad()
def sim_ota(boxes, objectness, kinds, centres, stride, truth, present, top=10):
    """Which rows of B pictures learn (B x N), which truth each of them (B x N) and their IoU with it (B x N).

    All pictures at once and without a step that waits for a number, so that a GPU is kept busy."""
    distance = (centres[None, :, None] - truth[:, None, :, 1:3]).abs()
    in_centre = (distance < 2.5 * stride[:, None, None]).all(3) & present[:, None]
    in_box = (distance < truth[:, None, :, 3:] / 2).all(3) & present[:, None]
    candidate = (in_centre | in_box).any(2, keepdim=True) & present[:, None]
    iou = pairwise_iou(boxes, truth[..., 1:])
    score = (kinds.sigmoid() * objectness.sigmoid()[..., None]).sqrt().clamp(1e-6, 1 - 1e-6)
    # Binary cross-entropy against the one-hot class of each truth, without a rows x truths x classes tensor.
    background = -torch.log1p(-score)
    of_truth = truth[..., 0].long()[:, None].expand(-1, score.shape[1], -1)
    kind_cost = background.sum(2, keepdim=True) - background.gather(2, of_truth) - score.log().gather(2, of_truth)
    cost = kind_cost - 3.0 * (iou + 1e-8).log() + 1e5 * ~(in_centre & in_box)
    cost = cost.masked_fill(~candidate, float("inf"))
    top = min(top, cost.shape[1])
    count = iou.masked_fill(~candidate, 0).topk(top, 1).values.sum(1).int().clamp(min=1)
    least = cost.topk(top, 1, largest=False)
    taken = (torch.arange(top, device=cost.device)[None, :, None] < count[:, None]) & least.values.isfinite()
    chosen = torch.zeros_like(candidate).scatter_(1, least.indices, taken)
    # A row that several truths chose learns the one that costs least.
    crowded = chosen.sum(2) > 1
    which = torch.where(crowded, cost.argmin(2), chosen.int().argmax(2))
    return chosen.any(2), which, iou.gather(2, which[..., None]).squeeze(2)


def loss(levels, truths, l1=False):
    """Mean loss per assigned row. `truths`: per image a tensor K x 5 of class, cx, cy, w, h in input pixels."""
    raw, grid, stride = flatten(levels)
    truth, present = padded(truths, raw.device)
    boxes = decode(raw[..., :4], grid, stride)
    fixed = raw.detach()
    assigned, which, iou = sim_ota(boxes.detach(), fixed[..., 4], fixed[..., 5:], (grid + 0.5) * stride[:, None], stride, truth, present)
    object_loss = F.binary_cross_entropy_with_logits(raw[..., 4], assigned.to(raw), reduction="sum")
    image, row = assigned.nonzero(as_tuple=True)
    wanted = truth[image, which[image, row]]
    box_loss = giou_loss(boxes[image, row], wanted[:, 1:]).sum()
    kinds = F.one_hot(wanted[:, 0].long(), raw.shape[2] - 5).to(raw) * iou[image, row, None]
    kind_loss = F.binary_cross_entropy_with_logits(raw[image, row, 5:], kinds, reduction="sum")
    total = 5.0 * box_loss + object_loss + kind_loss
    if l1:
        s = stride[row, None]
        exact = torch.cat((wanted[:, 1:3] / s - grid[row], (wanted[:, 3:] / s + 1e-8).log()), 1)
        total = total + (raw[image, row, :4] - exact).abs().sum()
    return total / max(len(row), 1)
