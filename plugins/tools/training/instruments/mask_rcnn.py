"""Mask R-CNN (He et al. 2017) on the detector's backbone: feature pyramid, proposals, box and mask heads of torchvision, made light."""

import torch
from torch import nn
from torchvision.models.detection.faster_rcnn import FastRCNNPredictor, TwoMLPHead
from torchvision.models.detection.image_list import ImageList
from torchvision.models.detection.mask_rcnn import MaskRCNNHeads, MaskRCNNPredictor
from torchvision.models.detection.roi_heads import RoIHeads
from torchvision.models.detection.rpn import AnchorGenerator, RegionProposalNetwork, RPNHead
from torchvision.ops import FeaturePyramidNetwork, MultiScaleRoIAlign
from torchvision.ops.feature_pyramid_network import LastLevelMaxPool

from .yolox import Yolox, load_onnx

CHANNELS = 64
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


class Backbone(nn.Module):
    """YOLOX-nano's dark2 to dark5 with a feature pyramid of strides 8, 16, 32 and a pooled 64."""

    def __init__(self):
        super().__init__()
        whole = Yolox(1)
        self.stem, self.dark2, self.dark3 = whole.stem, whole.dark2, whole.dark3
        self.dark4, self.dark5 = whole.dark4, whole.dark5
        self.pyramid = FeaturePyramidNetwork([64, 128, 256], CHANNELS, extra_blocks=LastLevelMaxPool())
        self.wide_stem = False

    def forward(self, x):
        if not self.wide_stem:
            x = torch.cat((x[..., ::2, ::2], x[..., 1::2, ::2], x[..., ::2, 1::2], x[..., 1::2, 1::2]), 1)
        c3 = self.dark3(self.dark2(self.stem(x)))
        c4 = self.dark4(c3)
        return self.pyramid({"0": c3, "1": c4, "2": self.dark5(c4)})


class MaskRcnn(nn.Module):
    """Input B x 3 x H x W, BGR 0..255. `targets`: per picture boxes K x 4 (corners, px), labels K (from 1), masks K x H x W u8, ignored M x 4.

    Gives a dictionary of losses where targets are given, else per picture boxes, labels, scores and masks K x 1 x 40 x 40 (0..1).
    """

    def __init__(self, classes):
        super().__init__()
        self.backbone = Backbone()
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
            mask_roi_pool=MultiScaleRoIAlign(LEVELS, MASK_PX // 2, 2),
            mask_head=MaskRCNNHeads(CHANNELS, (CHANNELS,) * 3, 1),
            mask_predictor=MaskRCNNPredictor(CHANNELS, CHANNELS, classes + 1),
        )

    def forward(self, x, targets=None):
        features = self.backbone(x)
        sizes = [(x.shape[-2], x.shape[-1])] * x.shape[0]
        found, losses = self.proposals(ImageList(x, sizes), features, targets)
        if targets is not None:
            self.heads.ignored = [t["ignored"] for t in targets]
        result, more = self.heads(features, found, sizes, targets)
        return {**losses, **more} if targets is not None else result

    def train(self, mode=True):
        """The backbone's normalisation keeps the detector's statistics: a batch here is small and mixed from unlike sources."""
        super().train(mode)
        for module in self.backbone.modules():
            if isinstance(module, nn.BatchNorm2d):
                module.eval()
        return self


def start_from(model, path):
    """Takes the backbone of a trained detector: weights.pt or state.pt of train_detector.py, or a YOLOX-nano ONNX file."""
    if path.suffix == ".onnx":
        state = load_onnx(Yolox(1), path).state_dict()
    else:
        state = torch.load(path, map_location="cpu")
        state = state.get("average", state)
    wanted = {k for k in model.backbone.state_dict() if not k.startswith("pyramid.")}
    missing = wanted - state.keys()
    if missing:
        raise ValueError(f"{path}: no weights for {sorted(missing)[0]} and {len(missing) - 1} more: not a detector of train_detector.py")
    model.backbone.load_state_dict({k: state[k] for k in wanted}, strict=False)
