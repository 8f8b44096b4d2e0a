#!/usr/bin/env python3
"""Trains an instrument detector on frames with boxes and writes checkpoints from which it goes on.

    python3 train_detector.py --data FOLDER --out run [--start FILE] [--without v02,v08] [--also frames]
    python3 train_detector.py --data FOLDER --out run --fold 1 --network lite0 --start imagenet --width 512 --height 288 [--resume]

FOLDER holds VOC (ImageSets, Annotations, JPEGImages), COCO (train.json) or YOLO (images/train, labels/train) data. Frames of --also, as those
of make_phantom_frames.py, make a fixed share of the samples. Seeds are fixed: the same data, arguments and PyTorch give the same weights
(with --minutes, the same as far as the machine is as fast).
With --fold N the operations of fold N (folds.toml) are kept out, the training lies in OUT/foldN, and what it finds in them is written to
OUT/foldN.json at the end, for `panoscope eval detect --folds OUT`.
Training starts from the detector that ships, unless --start names other weights: an ONNX file of export_detector.py or of YOLOX-nano, a checkpoint of
this script, `imagenet` for the backbone of the lite networks, or `none` for random ones. The detector that ships has seen most frames of
m2cai16-tool-locations: a score on those says little then, and --fold refuses it.
With --resume, a training that has ended writes that file again, without learning.
It is interrupted with SIGTERM or Ctrl-C: it writes a checkpoint first, and --resume goes on at the same sample.
Needs PyTorch, NumPy, OpenCV and, to start from ONNX, onnx: pip install torch numpy opencv-python-headless onnx
"""

import argparse
import copy
import itertools
import os
import time
from pathlib import Path

from instruments import folds as fold_files

# Weights of the `lite0` detector that ships.
SHIPPED = Path(__file__).resolve().parent / "weights" / "instruments.pt"
NEEDED = "pip install torch numpy opencv-python-headless onnx"
# What may change when a training goes on.
FREE = ("resume", "stop_after", "threads", "workers", "device", "pause_while", "test_every", "save_every_min", "out", "data", "folds")


def arguments():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--data", required=True, type=Path)
    p.add_argument("--split", default="trainval", help="which split to learn from")
    p.add_argument("--test-split", default="test")
    p.add_argument("--also", type=Path, nargs="+", default=[], help="folders of more frames to learn from (split `train`), as of make_phantom_frames.py")
    p.add_argument("--also-share", type=float, default=0.12, help="share of the samples that come from --also")
    p.add_argument("--missing-labels", type=Path, help="file of instruments without a label, added to the frames that are learned from (missing_labels.toml)")
    p.add_argument("--without", default="", help="operations kept out of training and tested on instead: v02,v08")
    p.add_argument("--fold", help="keep the operations of this fold out, and write what is found in them")
    p.add_argument("--folds", type=Path, default=fold_files.SHIPPED, help="file of folds (default: %(default)s)")
    p.add_argument("--network", default="lite0", choices=("yolox-nano", "lite0", "lite1", "lite2"))
    p.add_argument("--start", default=str(SHIPPED), help="weights to start from: imagenet, none, an ONNX file or a checkpoint (default: %(default)s)")
    p.add_argument("--out", required=True, type=Path)
    p.add_argument("--resume", action="store_true", help="go on with the training in OUT, if there is one")
    p.add_argument("--epochs", type=int, default=40)
    p.add_argument("--minutes", type=float, help="end after these minutes of training, pauses left out, instead of after --epochs")
    p.add_argument("--plain-share", type=float, default=0.15, help="last share of the training on whole, hardly changed frames")
    p.add_argument("--batch", type=int, default=16)
    p.add_argument("--rate", type=float, default=1e-3)
    p.add_argument("--backbone-rate", type=float, default=0.3, help="rate of a pretrained backbone, as a share of --rate")
    p.add_argument("--freeze", type=int, default=0, help="stages of a pretrained backbone that stay as they are, its stem with them")
    p.add_argument("--width", type=int, default=384)
    p.add_argument("--height", type=int, default=224)
    p.add_argument("--augment", default="usual", help="changes of the pictures: all, usual, none, names, -names: usual,blood,-smoke")
    p.add_argument("--mosaic", type=float, default=0.4, help="share of the samples made of four frames")
    p.add_argument("--pasting", type=float, default=0.35, help="probability of a tool pasted from another frame, and of one more after it")
    p.add_argument("--balance", type=float, default=0.5, help="how much more often seldom classes come up: 0 not, 1 all alike")
    p.add_argument("--balance-per-operation", action="store_true", help="balance the classes in each operation for itself")
    p.add_argument("--bf16", action="store_true", help="compute in bfloat16 where PyTorch holds it to be safe")
    p.add_argument("--compile", action="store_true", help="compile the network first, a fifth to half faster; needs a C++ compiler")
    p.add_argument("--seed", type=int, default=1)
    p.add_argument("--threads", type=int, default=2)
    p.add_argument("--device", default="cpu", help="cpu, or cuda where PyTorch has one (default: %(default)s)")
    p.add_argument("--workers", type=int, default=0, help="processes that make the samples; 0: a thread")
    p.add_argument("--test-every", type=int, default=5, help="epochs between two tests; 0: at the end only")
    p.add_argument("--save-every-min", type=float, default=5.0, help="minutes between two checkpoints; one is written after each epoch anyway")
    p.add_argument("--stop-after", type=int, metavar="STEPS", help="end after these steps with a checkpoint; --resume goes on")
    p.add_argument("--pause-while", type=Path, metavar="FILE", help="wait between batches while FILE exists")
    a = p.parse_args()
    # Reported before anything large is loaded.
    named = [("--start", Path(a.start))] if a.start not in ("none", "imagenet") else []
    for option, path in (("--data", a.data), ("--missing-labels", a.missing_labels), *(("--also", path) for path in a.also), *named):
        if path and not path.exists():
            p.error(f"{option}: there is no {path}")
    if a.width % 32 or a.height % 32:
        p.error("--width and --height are multiples of 32")
    if a.minutes and a.workers:
        p.error("--workers makes samples ahead, and --minutes does not know how many there will be: give --epochs")
    if a.fold and a.without:
        p.error("--fold and --without both name what is kept out: give one of them")
    if a.fold and a.start == str(SHIPPED):
        p.error("--fold: the detector that ships has learned from the frames that the fold keeps out; name other weights with --start")
    try:
        a.held_out = set(fold_files.read(a.folds).held_out(a.fold)) if a.fold else set(filter(None, a.without.split(",")))
    except fold_files.FoldsError as wrong:
        p.error(str(wrong))
    return a


def read_frames(a):
    """Frames to learn from and frames to test on, decoded."""
    from instruments import missing_labels
    from instruments.data import read

    splits = fold_files.read(a.folds).splits if a.fold else (a.split, a.test_split)
    everything = {split: read(a.data, split) for split in splits}
    if a.fold:
        try:
            fold_files.read(a.folds).check_operations({f.group for frames in everything.values() for f in frames})
        except fold_files.FoldsError as wrong:
            raise SystemExit(f"{a.data}: {wrong}") from None
    # A fold is a split of its own: what the data set calls test is learned from too.
    train = [f for split in (splits if a.fold else splits[:1]) for f in everything[split] if f.group not in a.held_out]
    test = [f for split in splits for f in everything[split] if f.group in a.held_out] if a.held_out else everything[a.test_split]
    # Scored against the labels as they were published: two trainings are compared on the same truth.
    if a.missing_labels:
        try:
            added = missing_labels.add(train, missing_labels.read(a.missing_labels))
        except missing_labels.MissingLabelsError as wrong:
            raise SystemExit(str(wrong)) from None
        print(f"{a.missing_labels}: {added} labels added to the frames to learn from", flush=True)
    missing = a.held_out - {f.group for f in test}
    if missing:
        raise SystemExit(f"{a.data}: no frame of the operations {', '.join(sorted(missing))}")
    return [f.load(a.width * 5 // 4) for f in train], [f.load(a.width * 5 // 4) for f in test]


def main():
    a = arguments()
    # Threads that wait for each other without spinning leave the processor to those that work.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    try:
        import cv2
        import numpy as np
        import torch

        from instruments import networks
        from instruments.assign import loss
        from instruments.augment import Augmented, chosen_changes
        from instruments.batches import batches, blend, layout
        from instruments.data import CLASSES, read
        from instruments.score import average_precision, detect
        from instruments.training import Checkpoint, Pause, Schedule, Stop, parameter_groups
    except ModuleNotFoundError as missing:
        raise SystemExit(f"training needs {missing.name}: {NEEDED}") from None

    torch.manual_seed(a.seed)
    torch.set_num_threads(a.threads)
    if torch.device(a.device).type != "cpu" and not torch.cuda.is_available():
        raise SystemExit(f"--device {a.device}: PyTorch {torch.__version__} finds no such device; leave --device out to learn on the processor")
    cv2.setNumThreads(1)
    folder = a.out / f"fold{a.fold}" if a.fold else a.out
    folder.mkdir(parents=True, exist_ok=True)
    settings = {k: v if isinstance(v, (int, float, str, type(None))) else str(v) for k, v in vars(a).items() if k not in FREE and k != "held_out"}
    settings["held_out"] = ",".join(sorted(a.held_out))
    checkpoint = Checkpoint(folder, settings)
    state = checkpoint.read(a.resume)

    model = networks.build(a.network, len(CLASSES)).to(a.device, memory_format=layout(a.device))
    if a.start != "none" and state is None:
        networks.start(model, a.network, a.start if a.start == "imagenet" else Path(a.start))
    average = copy.deepcopy(model).eval()
    optimiser = torch.optim.AdamW(parameter_groups(model, a.rate, a.backbone_rate), lr=a.rate)
    step, trained_s = 0, 0.0
    if state:
        model.load_state_dict(state["model"])
        average.load_state_dict(state["average"])
        optimiser.load_state_dict(state["optimiser"])
        step, trained_s = state["step"], state["trained_s"]

    forward = torch.compile(model) if a.compile else model
    train, test = read_frames(a)
    print(f"{len(train)} frames to learn from, {len(test)} to test on" + (f"; goes on after step {step}" if state else ""), flush=True)
    more = [f.load(a.width * 5 // 4) for path in a.also for f in read(path, "train")]
    samples = Augmented(
        train + more, a.width, a.height, a.seed, mosaic=a.mosaic, pasting=a.pasting, balance=a.balance, guests=len(more),
        guests_share=a.also_share, changes=chosen_changes(a.augment), per_operation=a.balance_per_operation,
    )  # fmt: skip
    per_epoch = len(train) // a.batch
    schedule = Schedule(a.epochs * per_epoch, a.minutes)
    pause, stop = Pause(a.pause_while), Stop()

    def save():
        checkpoint.write(model=model.state_dict(), average=average.state_dict(), optimiser=optimiser.state_dict(), step=step, trained_s=trained_s)

    def is_plain(epoch):
        """Asked for the epoch's first step, so that a training that goes on amid an epoch goes on in the same way."""
        return schedule.progress((epoch - 1) * per_epoch, trained_s) >= 1 - a.plain_share

    def made(first, count):
        plan = [(s * a.batch, is_plain(s // per_epoch + 1)) for s in range(first, first + count)]
        return batches(samples, plan, a.batch, a.device, a.workers)

    # Processes are started once; a training by minutes does not know its last epochs beforehand.
    ahead = None if a.minutes else made(step, schedule.steps - step)
    progress, saved, begun_at = schedule.progress(step, trained_s), time.monotonic(), step
    while progress < 1.0:
        model.train()
        if a.freeze:
            model.freeze(a.freeze)
        epoch, rest = step // per_epoch + 1, per_epoch - step % per_epoch
        plain = is_plain(epoch)
        sum_loss, first, epoch_s = 0.0, step, trained_s
        for x, truths in itertools.islice(ahead, rest) if ahead else made(step, rest):
            pause.wait()
            begun = time.monotonic()
            for group in optimiser.param_groups:
                group["lr"] = group["peak"] * schedule.factor(step, progress)
            with torch.autocast(torch.device(a.device).type, torch.bfloat16, enabled=a.bf16):
                levels = forward(x)
            value = loss([level.float() for level in levels], truths, l1=plain)
            optimiser.zero_grad(set_to_none=True)
            value.backward()
            torch.nn.utils.clip_grad_norm_(model.parameters(), 10.0)
            optimiser.step()
            step += 1
            sum_loss = sum_loss + value.detach()
            blend(average, model, min(0.9995, (1 + step) / (20 + step)))
            trained_s += time.monotonic() - begun
            progress = schedule.progress(step, trained_s)
            if stop.requested or step - begun_at == a.stop_after:
                save()
                raise SystemExit(f"interrupted after step {step}; --resume goes on")
            if progress >= 1.0:
                break
            if time.monotonic() - saved > 60 * a.save_every_min:
                save()
                saved = time.monotonic()
        done = step - first
        line = f"epoch {epoch:3d}  {100 * progress:3.0f} %  loss {sum_loss / done:.3f}  {done * a.batch / (trained_s - epoch_s):.1f} frames/s"
        save()
        if progress < 1.0 and a.test_every and epoch % a.test_every == 0:
            line += "  " + words(average_precision(test, detect(average, test, a.width, a.height), len(CLASSES)), CLASSES, np)
        print(line, flush=True)
    # From a GPU, too, a file that every machine reads.
    torch.save({k: v.cpu() for k, v in average.state_dict().items()}, folder / "weights.pt")
    found = detect(average, test, a.width, a.height)
    print(f"{step} steps in {trained_s / 60:.1f} min  " + words(average_precision(test, found, len(CLASSES)), CLASSES, np), flush=True)
    if a.fold:
        # From the pictures as they were shrunk to those as they are stored.
        frames = {f.name: [[r[0], r[1], *(r[2:6] / f.scale), r[6]] for r in rows] for f, rows in zip(test, found)}
        network = {"steps": step, "trained_min": round(trained_s / 60, 1), **settings}
        path = fold_files.write_predictions(a.out, fold_files.read(a.folds), a.fold, CLASSES, network, frames)
        print(f"{path}: predictions on {len(frames)} frames", flush=True)


def words(ap, classes, np):
    """Average precision as one line."""
    return f"mAP50 {np.nanmean(ap):.4f}  " + " ".join(f"{n}={v:.3f}" for n, v in zip(classes, ap))


if __name__ == "__main__":
    main()
