#!/usr/bin/env python3
"""Adapts a trained detector to a hospital's own pictures, without labels.

    python3 adapt_detector.py --frames OPERATION.mp4 MORE_FRAMES/ --out adapted
    python3 adapt_detector.py --frames FRAMES --network lite0 --start run/weights.pt --calibration calibration.json --source LABELLED --out adapted

--frames names videos and folders of pictures. A teacher, the running average of the student, looks at each picture as it is; boxes that it is sure of
(--confidence, a probability) are learned by the student on the same picture, turned, shifted and changed in light and colour (mean teacher, Tarvainen
and Valpola 2017; Liu et al. 2021). What the teacher half believes is covered in the student's picture: neither an instrument nor nothing. Labelled
frames of --source keep it from forgetting.
Writes OUT/adapted.pt, OUT/adapted.onnx for the `yolo` node, OUT/report.md, OUT/report.json and OUT/changes.png: what it finds now and did not before,
on frames that it did not learn from. Nothing is overwritten, the detector that it started from least of all. The report warns where the adapted
detector differs too much; whether it is better, only labels can tell: `panoscope eval detect --truth`.
It is interrupted with SIGTERM or Ctrl-C; --resume goes on at the same step. The same frames, arguments and PyTorch give the same weights.
Needs PyTorch, NumPy, OpenCV and onnx; with onnxruntime the file also knows the new pictures: pip install torch numpy opencv-python-headless onnx onnxruntime
"""

import argparse
import copy
import json
import os
from pathlib import Path

# Weights and file of the `lite0` detector that ships.
SHIPPED = Path(__file__).resolve().parent / "weights" / "instruments.pt"
SHIPPED_FILE = Path(__file__).resolve().parent.parent / "models" / "instruments.onnx"
NEEDED = "pip install torch numpy opencv-python-headless onnx"
# What may change when an adaptation goes on.
FREE = ("resume", "stop_after", "threads", "pause_while", "out", "save_every")


def arguments():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--frames", required=True, nargs="+", type=Path, help="videos and folders of pictures, without labels")
    p.add_argument("--network", default="lite0", choices=("yolox-nano", "lite0", "lite1", "lite2"))
    p.add_argument("--start", default=SHIPPED, type=Path, help="detector to adapt: an ONNX file (yolox-nano) or a checkpoint (default: the one that ships)")
    p.add_argument("--out", required=True, type=Path)
    p.add_argument("--source", type=Path, help="labelled frames that it learned from, to keep it from forgetting")
    p.add_argument("--source-split", default="trainval")
    p.add_argument("--source-share", type=float, default=0.5, help="share of each batch that comes from --source (default: %(default)s)")
    p.add_argument("--calibration", type=Path, metavar="FILE.json", help="calibration of the scores (default: the one in --start, if it has one)")
    p.add_argument("--confidence", type=float, default=0.7, help="probability from which a box of the teacher is learned (default: %(default)s)")
    p.add_argument("--unsure", type=float, default=0.15, help="probability from which a box below --confidence is covered (default: %(default)s)")
    p.add_argument("--every-s", type=float, default=1.0, help="seconds between two frames of a video (default: %(default)s)")
    p.add_argument("--most-frames", type=int, default=4000)
    p.add_argument("--aside", type=float, default=0.2, help="share of the frames kept for the report (default: %(default)s)")
    p.add_argument("--steps", type=int, default=1000)
    p.add_argument("--batch", type=int, default=8)
    p.add_argument("--rate", type=float, default=1e-4)
    p.add_argument("--keep", type=float, default=0.998, help="share of the teacher that stays at each step (default: %(default)s)")
    p.add_argument("--width", type=int, default=384)
    p.add_argument("--height", type=int, default=224)
    p.add_argument("--augment", default="all", help="changes of the student's pictures, as those of train_detector.py")
    p.add_argument("--seed", type=int, default=1)
    p.add_argument("--threads", type=int, default=2)
    p.add_argument("--resume", action="store_true", help="go on with the adaptation in OUT, if there is one")
    p.add_argument("--save-every", type=int, default=100, metavar="STEPS")
    p.add_argument("--stop-after", type=int, metavar="STEPS", help="end after these steps with a checkpoint; --resume goes on")
    p.add_argument("--pause-while", type=Path, metavar="FILE", help="wait between steps while FILE exists")
    a = p.parse_args()
    # Reported before anything large is loaded.
    for option, path in [("--frames", f) for f in a.frames] + [("--start", a.start), ("--source", a.source), ("--calibration", a.calibration)]:
        if path and not path.exists():
            p.error(f"{option}: there is no {path}")
    if a.width % 32 or a.height % 32:
        p.error("--width and --height are multiples of 32")
    if not 0 < a.unsure <= a.confidence < 1:
        p.error("--unsure and --confidence are probabilities, the first not above the second")
    if not 0 < a.aside < 1:
        p.error("--aside is a share above 0 and below 1")
    if (a.out / "adapted.pt").exists():
        p.error(f"--out: {a.out} holds a finished adaptation, which is not overwritten; name another folder")
    return a


def calibration_of(a):
    """The curve that makes probabilities of scores, and the metadata of it that an adapted file carries on."""
    from instruments.unlabelled import Curve

    stored = {}
    if a.calibration:
        from export_detector import CLASSES, calibration_metadata

        stored = calibration_metadata(a.calibration, CLASSES)
    elif a.start == SHIPPED or a.start.suffix == ".onnx":
        import onnx

        file = SHIPPED_FILE if a.start == SHIPPED else a.start
        held = {p.key: p.value for p in onnx.load(str(file), load_external_data=False).metadata_props}
        stored = {k: v for k, v in held.items() if k.startswith(("calibration_", "class_limits"))}
    if "calibration_score" in stored:
        return Curve(*map(float, stored["calibration_score"].split())), stored
    print("the detector has no calibration: its scores are taken for probabilities, which they are not; --calibration gives it one", flush=True)
    return Curve(), {}


def main():
    a = arguments()
    # Threads that wait for each other without spinning leave the processor to those that work.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    try:
        import cv2
        import numpy as np
        import torch

        from instruments import adaptation, networks, unlabelled
        from instruments.assign import loss
        from instruments.augment import Augmented, chosen_changes, lab_statistics
        from instruments.batches import blend, store
        from instruments.data import CLASSES, read
        from instruments.score import average_precision
        from instruments.score import detect as score_detect
        from instruments.training import Checkpoint, Pause, Schedule, Stop, parameter_groups
    except ModuleNotFoundError as missing:
        raise SystemExit(f"adapting needs {missing.name}: {NEEDED}") from None

    torch.manual_seed(a.seed)
    torch.set_num_threads(a.threads)
    cv2.setNumThreads(1)
    curve, carried = calibration_of(a)
    changes = chosen_changes(a.augment)
    frames = unlabelled.read(a.frames, a.width * 5 // 4, a.every_s, a.most_frames)
    if len(frames) < 2:
        raise SystemExit(f"{', '.join(map(str, a.frames))}: {len(frames)} different frames; at least two are needed, one to adapt on and one to report")
    learned, held = unlabelled.aside(frames, a.aside)
    source = [f.load(a.width * 5 // 4) for f in read(a.source, a.source_split)] if a.source else []
    a.out.mkdir(parents=True, exist_ok=True)
    plain = lambda v: " ".join(map(str, v)) if isinstance(v, list) else v if isinstance(v, (int, float, str, type(None))) else str(v)
    settings = {k: plain(v) for k, v in vars(a).items() if k not in FREE}
    checkpoint = Checkpoint(a.out, settings)
    state = checkpoint.read(a.resume)
    print(f"{len(learned)} frames to adapt on, {len(held)} for the report, {len(source)} labelled" + (f"; goes on after step {state['step']}" if state else ""), flush=True)

    start = networks.build(a.network, len(CLASSES)).to(memory_format=torch.channels_last)
    networks.start(start, a.network, a.start)
    student, teacher = copy.deepcopy(start), copy.deepcopy(start).eval()
    optimiser = torch.optim.AdamW(parameter_groups(student, a.rate, 1.0), lr=a.rate)
    step, used = 0, 0
    if state:
        student.load_state_dict(state["student"])
        teacher.load_state_dict(state["teacher"])
        optimiser.load_state_dict(state["optimiser"])
        step, used = state["step"], state["used"]
    colours = [lab_statistics(f.picture) for f in learned]
    labelled = Augmented(source, a.width, a.height, a.seed, changes=changes) if source else None
    from_source = min(a.batch - 1, round(a.batch * a.source_share)) if source else 0
    schedule, pause, stop, begun_at = Schedule(a.steps), Pause(a.pause_while), Stop(), step

    def save():
        checkpoint.write(student=student.state_dict(), teacher=teacher.state_dict(), optimiser=optimiser.state_dict(), step=step, used=used)

    while step < a.steps:
        pause.wait()
        rng = np.random.default_rng((a.seed, step))
        chosen = rng.choice(len(learned), a.batch - from_source, replace=len(learned) < a.batch)
        found = unlabelled.detect(teacher, [learned[i] for i in chosen], a.width, a.height, curve, a.unsure)
        samples = []
        for i, rows in zip(chosen, found):
            boxes, hidden = unlabelled.pseudo(rows, a.confidence, a.unsure)
            used += len(boxes)
            other = colours[int(rng.integers(len(colours)))]
            samples.append(unlabelled.strong(learned[i], boxes, hidden, other, a.width, a.height, rng, changes))
        samples += [labelled.sample(step * from_source + k) for k in range(from_source)]
        # A batch in which nothing is known teaches only that there is nothing.
        if any(len(boxes) for _, boxes in samples):
            student.train()
            for module in student.modules():
                if isinstance(module, torch.nn.BatchNorm2d):
                    # Statistics of few frames would move what all others rely on.
                    module.eval()
            for group in optimiser.param_groups:
                group["lr"] = group["peak"] * schedule.factor(step, schedule.progress(step, 0.0))
            x = torch.from_numpy(np.stack([p for p, _ in samples])).permute(0, 3, 1, 2).float()
            value = loss(student(x), [torch.from_numpy(b) for _, b in samples])
            optimiser.zero_grad(set_to_none=True)
            value.backward()
            torch.nn.utils.clip_grad_norm_(student.parameters(), 10.0)
            optimiser.step()
            blend(teacher, student, a.keep)
        step += 1
        if stop.requested or step - begun_at == a.stop_after:
            save()
            raise SystemExit(f"interrupted after step {step}; --resume goes on")
        if step % a.save_every == 0:
            save()
            print(f"step {step} of {a.steps}, {used} boxes learned so far", flush=True)

    save()
    before = unlabelled.detect(start, held, a.width, a.height, curve)
    after = unlabelled.detect(teacher, held, a.width, a.height, curve)
    report = adaptation.summary(before, after, CLASSES) | {"boxes_learned": used, "steps": step}
    known = None
    if source:
        judged = source[:: max(1, len(source) // 200)]
        mean = lambda model: float(np.nanmean(average_precision(judged, score_detect(model, judged, a.width, a.height), len(CLASSES))))
        known = {"before": mean(start), "after": mean(teacher)}
    warned = adaptation.warnings(report, known)
    if not used:
        warned.insert(0, "the teacher was sure of no box: nothing was learned from these pictures; a lower --confidence may help")
    adaptation.sheet(a.out / "changes.png", held, before, after, CLASSES)
    (a.out / "report.json").write_text(json.dumps({**report, "source_map50": known, "warnings": warned, "settings": settings}, indent=1) + "\n")
    (a.out / "report.md").write_text(adaptation.text(report, warned, known, settings))
    export(a, teacher, carried, learned, source)
    # The last one: while it is missing, --resume writes all of this again.
    store(a.out / "adapted.pt", teacher.state_dict())
    print(f"{a.out / 'report.md'}: agreement {100 * report['agreement']:.0f} %, {used} boxes learned", flush=True)
    for line in warned:
        print(f"warning: {line}", flush=True)


def export(a, teacher, carried, learned, source):
    """Writes the file for the `yolo` node, with statistics of the pictures that it has seen."""
    try:
        import torch

        import export_detector
        from instruments import familiar
        from instruments.networks import Exported
        from instruments.onnx_store import write
        from instruments.pictures import Statistics
    except ModuleNotFoundError as missing:
        print(f"{a.out}/adapted.onnx: not written: {missing}; export_detector.py --weights {a.out}/adapted.pt writes it later", flush=True)
        return
    path = a.out / "adapted.onnx"
    with torch.no_grad():
        metadata = export_detector.export(Exported(teacher, features=True).eval(), a.network, path, a.width, a.height, False, export_detector.CLASSES, carried)
    metadata["source"] += f"; adapted without labels on {len(learned)} frames"
    try:
        session = familiar.Session(path, a.threads)
        seen = learned + source[:: max(1, len(source) // 500)]
        rows = [familiar.picture_features(session, f.picture, a.width, a.height) for f in seen]
        metadata |= Statistics.with_limit(rows, [f.group for f in seen]).metadata()
    except ModuleNotFoundError as missing:
        print(f"{path} does not know its pictures: {missing}", flush=True)
    write(path, metadata)
    print(f"{path}: for the `yolo` node", flush=True)


if __name__ == "__main__":
    main()
