"""Mask R-CNN (He et al. 2017) on the detector's backbone and neck: proposals, box and mask heads of torchvision, made light."""

import torch
import torch.nn.functional as F
from torch import nn
from torchvision.models.detection.faster_rcnn import FastRCNNPredictor, TwoMLPHead
from torchvision.models.detection.image_list import ImageList
from torchvision.models.detection.mask_rcnn import MaskRCNNHeads, MaskRCNNPredictor
from torchvision.models.detection.roi_heads import RoIHeads
from torchvision.models.detection.rpn import AnchorGenerator, RegionProposalNetwork, RPNHead
from torchvision.ops import MultiScaleRoIAlign

from .folding import fold_all, raw_stem
from .lite import FINE_TAP, STAGES, TAPS, LiteFeatures

#: Channels of a level of the neck, and of the heads' own convolutions.
CHANNELS, INNER = 80, 64
LEVELS = ["0", "1", "2"]
#: Side of a mask, px: thin shafts lie across their boxes, 28 would leave them two pixels.
MASK_PX = 40
#: Share of a proposal inside an ignored box from which it teaches nothing.
IGNORED_SHARE = 0.4


def share_inside(boxes, regions):
    """For each of `boxes` (N x 4, corners) the largest share of its area inside one of `regions` (M x 4)."""
    if len(regions) == 0 or len(boxes) == 0:
        return boxes.new_zeros(len(boxes))
    low = torch.maximum(boxes[:, None, :2], regions[None, :, :2])
    high = torch.minimum(boxes[:, None, 2:], regions[None, :, 2:])
    both = (high - low).clamp(min=0).prod(2)
    return (both / (boxes[:, 2:] - boxes[:, :2]).clamp(min=1e-3).prod(1)[:, None]).amax(1)


class Proposals(RegionProposalNetwork):
    """Learns nothing from anchors in doubtful regions."""

    def assign_targets_to_anchors(self, anchors, targets):
        labels, matched = super().assign_targets_to_anchors(anchors, targets)
        for label, anchor, target in zip(labels, anchors, targets):
            label[(label == 0) & (share_inside(anchor, target["ignored"]) > IGNORED_SHARE)] = -1
        return labels, matched


class Heads(RoIHeads):
    """Learns nothing from proposals in doubtful regions, which `forward` of the whole network leaves in `ignored`."""

    ignored = ()

    def assign_targets_to_proposals(self, proposals, gt_boxes, gt_labels):
        matched, labels = super().assign_targets_to_proposals(proposals, gt_boxes, gt_labels)
        for label, boxes, regions in zip(labels, proposals, self.ignored):
            label[(label == 0) & (share_inside(boxes, regions) > IGNORED_SHARE)] = -1
        return matched, labels


class Pyramid(nn.Module):
    """Backbone and neck of the `lite0` detector: strides 8, 16 and 32, 64 pooled from the last, and `fine` of stride 4 for the masks."""

    def __init__(self):
        super().__init__()
        self.features = LiteFeatures("lite0", CHANNELS)
        self.fine_own = nn.Conv2d(STAGES[FINE_TAP][4], INNER, 1)
        self.fine_deep = nn.Conv2d(CHANNELS, INNER, 1)
        self.first = None

    def forward(self, x):
        backbone = self.features.backbone
        # A folded network takes red first and 0..1 (`fold`).
        x = self.first(x) if self.first is not None else backbone.stem(backbone.normal(x))
        own, *levels = backbone.after_stem(x, (FINE_TAP, *TAPS))
        p3, p4, p5 = self.features.neck(levels)
        deep = F.interpolate(self.fine_deep(p3), scale_factor=2, mode="bilinear", align_corners=False)
        return {"0": p3, "1": p4, "2": p5, "pool": F.max_pool2d(p5, 1, 2), "fine": self.fine_own(own) + deep}

    def fold(self):
        """Puts normalisations into the convolutions; takes red first and 0..1 from then on."""
        first = raw_stem(self.features.backbone.stem)
        margin, conv, _ = first
        margin.value /= 255.0
        conv.weight.data = conv.weight.data.flip(1) * 255.0
        fold_all(self.features)
        self.first = first


class MaskRcnn(nn.Module):
    """Input B x 3 x H x W, BGR 0..255. `targets`: per picture boxes K x 4 (corners, px), labels K (from 1), masks K x H x W u8, ignored M x 4.

    Gives a dictionary of losses where targets are given, else per picture boxes, labels, scores and masks K x 1 x 40 x 40 (0..1).
    """

    def __init__(self, classes):
        super().__init__()
        self.pyramid = Pyramid()
        #: Whether backbone and neck compute in bfloat16.
        self.bf16 = False
        anchors = AnchorGenerator(((28,), (56,), (112,), (208,)), ((0.5, 1.0, 2.0),) * 4)
        self.proposals = Proposals(
            anchors,
            RPNHead(CHANNELS, 3),
            fg_iou_thresh=0.6,
            bg_iou_thresh=0.3,
            batch_size_per_image=96,
            positive_fraction=0.5,
            pre_nms_top_n={"training": 400, "testing": 200},
            post_nms_top_n={"training": 200, "testing": 60},
            nms_thresh=0.7,
        )
        side = 7
        self.heads = Heads(
            box_roi_pool=MultiScaleRoIAlign(LEVELS, side, 2),
            box_head=TwoMLPHead(CHANNELS * side * side, 256),
            box_predictor=FastRCNNPredictor(256, classes + 1),
            fg_iou_thresh=0.5,
            bg_iou_thresh=0.5,
            batch_size_per_image=48,
            positive_fraction=0.25,
            bbox_reg_weights=None,
            score_thresh=0.05,
            nms_thresh=0.5,
            detections_per_img=20,
            mask_roi_pool=MultiScaleRoIAlign(["fine"], MASK_PX // 2, 2),
            mask_head=MaskRCNNHeads(INNER, (INNER,) * 3, 1),
            mask_predictor=MaskRCNNPredictor(INNER, INNER, classes + 1),
        )

    def forward(self, x, targets=None):
        with torch.autocast(x.device.type, torch.bfloat16, enabled=self.bf16):
            features = self.pyramid(x)
        features = {k: v.float() for k, v in features.items()}
        sizes = [(x.shape[-2], x.shape[-1])] * x.shape[0]
        found, losses = self.proposals(ImageList(x, sizes), {k: v for k, v in features.items() if k != "fine"}, targets)
        if targets is not None:
            self.heads.ignored = [t["ignored"] for t in targets]
        result, more = self.heads(features, found, sizes, targets)
        return {**losses, **more} if targets is not None else result

    def fix_backbone(self):
        """Fixes the backbone; the neck and the heads learn."""
        self.pyramid.features.backbone.requires_grad_(False)

    def train(self, mode=True):
        """Normalisations keep the detector's statistics: a batch here is small and mixed from unlike sources."""
        super().train(mode)
        for module in self.pyramid.modules():
            if isinstance(module, nn.BatchNorm2d):
                module.eval()
        return self


def start_from(model, path):
    """Takes backbone and neck of a trained `lite0` detector: weights.pt or state.pt of train_detector.py."""
    state = torch.load(path, map_location="cpu", weights_only=True)
    state = state.get("average", state)
    wanted = set(model.pyramid.features.state_dict())
    missing = wanted - state.keys()
    if missing:
        raise ValueError(f"{path}: no weights for {sorted(missing)[0]} and {len(missing) - 1} more: not a `lite0` detector of train_detector.py")
    model.pyramid.features.load_state_dict({k: state[k] for k in wanted})
