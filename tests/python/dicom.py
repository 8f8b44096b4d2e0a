"""DICOM beside real peers: Orthanc is worklist server and archive, dciodvfy and pydicom read what `panoscope dicom` makes."""
import json
import os
import pathlib
import shutil
import signal
import socket
import subprocess
import tempfile
import time
import unittest
import urllib.request

import cv2
import numpy as np
import pydicom
from PIL import Image
from pydicom.encaps import generate_fragments
from pydicom.sr._concepts_dict import concepts

PANOSCOPE = os.environ["PANOSCOPE_BIN"]
WORKLISTS = "/usr/share/orthanc/plugins/libModalityWorklists.so"
STILL = "1.2.840.10008.5.1.4.1.1.7"
CLIP = "1.2.840.10008.5.1.4.1.1.77.1.1.1"
STUDY = "1.2.276.0.1.101"
REPORT = "1.2.840.10008.5.1.4.1.1.88.33"

ENTRY = """(0008,0005) CS [ISO_IR 192]
(0008,0050) SH [{accession}]
(0008,0090) PN [Referring^Doctor]
(0010,0010) PN [{name}]
(0010,0020) LO [{patient}]
(0010,0021) LO [General Hospital]
(0010,0030) DA [19700102]
(0010,0040) CS [F]
(0020,000d) UI [{study}]
(0032,1060) LO [Laparoscopy]
(0040,1001) SH [RP1]
(0040,0100) SQ
(fffe,e000) na
(0008,0060) CS [ES]
(0040,0001) AE [PANOSCOPE]
(0040,0002) DA [{date}]
(0040,0003) TM [070500]
(0040,0007) LO [Diagnostic laparoscopy]
(0040,0009) SH [{step}]
(fffe,e00d) na
(fffe,e0dd) na
"""


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


class Orthanc:
    """A server of its own in a folder."""

    def __init__(self, folder, dicom_port=None):
        self.folder, self.http = folder, free_port()
        self.dicom = dicom_port or free_port()
        for name in ("database", "worklist"):
            (folder / name).mkdir(exist_ok=True)
        self.process = None

    def start(self):
        settings = {
            "Name": "test", "StorageDirectory": str(self.folder / "database"), "IndexDirectory": str(self.folder / "database"),
            "HttpPort": self.http, "DicomPort": self.dicom, "DicomAet": "ARCHIVE", "DicomCheckCalledAet": True,
            "RemoteAccessAllowed": False, "AuthenticationEnabled": False, "DicomAlwaysAllowStore": True,
            "DicomAlwaysAllowFindWorklist": True, "DicomModalities": {"own": ["PANOSCOPE", "127.0.0.1", 104]},
            "Plugins": [WORKLISTS], "Worklists": {"Enable": True, "Database": str(self.folder / "worklist")},
        }
        (self.folder / "orthanc.json").write_text(json.dumps(settings))
        with open(self.folder / "orthanc.log", "a") as log:
            self.process = subprocess.Popen([shutil.which("Orthanc") or "/usr/sbin/Orthanc", str(self.folder / "orthanc.json")], stdout=log, stderr=log)
        until = time.monotonic() + 60
        while time.monotonic() < until:
            try:
                return self.get("/system")
            except OSError:
                if self.process.poll() is not None:
                    break
                time.sleep(0.05)
        raise AssertionError((self.folder / "orthanc.log").read_text())

    def stop(self):
        if self.process:
            self.process.send_signal(signal.SIGTERM)
            self.process.wait(60)
            self.process = None

    def get(self, path):
        with urllib.request.urlopen(f"http://127.0.0.1:{self.http}{path}", timeout=30) as answer:
            return answer.read()

    def objects(self, study):
        """What it has stored of a study, by SOP class."""
        found = {}
        for instance in json.loads(self.get("/instances")):
            file = self.folder / f"{instance}.dcm"
            file.write_bytes(self.get(f"/instances/{instance}/file"))
            stored = pydicom.dcmread(file)
            if stored.StudyInstanceUID == study:
                found.setdefault(stored.SOPClassUID, []).append(stored)
        return found

    def entry(self, file, **values):
        text = self.folder / f"{file}.dump"
        text.write_text(ENTRY.format(**values))
        subprocess.run(["dump2dcm", "-q", text, self.folder / "worklist" / f"{file}.wl"], check=True)


class Dicom(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = pathlib.Path(tempfile.mkdtemp(prefix="panoscope-dicom-"))
        cls.addClassCleanup(shutil.rmtree, cls.folder, ignore_errors=True)
        cls.server = Orthanc(cls.folder)
        cls.addClassCleanup(cls.server.stop)
        today = time.strftime("%Y%m%d")
        cls.server.entry("one", accession="A1001", name="Müller^Änne", patient="P-7", study=STUDY, step="S1", date=today)
        cls.server.entry("two", accession="A1002", name="Other^Person", patient="P-8", study="1.2.276.0.1.102", step="S2", date=today)
        cls.server.entry("old", accession="A0900", name="Past^Person", patient="P-1", study="1.2.276.0.1.100", step="S0", date="20200101")
        cls.server.start()
        cls.files = cls.folder / "files"
        cls.files.mkdir()
        cls.make_files()

    @classmethod
    def make_files(cls):
        graph = cls.folder / "clip.toml"
        graph.write_text(
            'name = "clip"\nmode = "batch"\nplugins = ["phantom", "sinks"]\n'
            '[nodes.scope]\ntype = "phantom"\nparams = { width = 160, height = 120 }\n'
            f'[nodes.clip]\ntype = "write_video"\ninputs = {{ image = "scope.left" }}\nparams = {{ path = "{cls.files}/clip_0002.mkv" }}\n')
        subprocess.run([PANOSCOPE, "run", graph, "--frames", "12", "--headless"], check=True, capture_output=True)
        rng = np.random.default_rng(7)
        cls.pixels = rng.integers(0, 256, (49, 65, 3), dtype=np.uint8)
        Image.fromarray(cls.pixels).save(cls.files / "still_0001.png")
        cls.gray = rng.integers(0, 256, (33, 31), dtype=np.uint8)
        Image.fromarray(cls.gray).save(cls.files / "still_0003.png")
        smooth = cv2.resize(cls.pixels[:8, :8], (64, 48), interpolation=cv2.INTER_CUBIC)
        Image.fromarray(smooth).save(cls.files / "still_0004.jpg", quality=92)
        (cls.files / "still_0001.jsonl").write_text(json.dumps({"picture": "still_0001.png", "table": [
            {"u0_px": 10, "v0_px": 20, "u1_px": 50, "v1_px": 40, "distance_mm": 12.25, "error_mm": 0.5}]}) + "\n")
        (cls.files / "depth.jsonl").write_text(
            '{"seq":0,"table":[{"u_px":1,"v_px":2,"depth_mm":50.5,"error_mm":null}]}\n{"seq":1,"table":[{"u_px":1,"v_px":2,"depth_mm":null,"error_mm":null}]}\n')
        (cls.files / "other.jsonl").write_text('{"seq":0,"scalar":{"value":1}}\n')

    def run_dicom(self, *words, code=0, **more):
        done = subprocess.run([PANOSCOPE, "dicom", *map(str, words)], capture_output=True, text=True, **more)
        self.assertEqual(done.returncode, code, done.stderr)
        return done.stdout + done.stderr

    def pacs(self, port=None, called="ARCHIVE"):
        return ["--pacs", f"127.0.0.1:{port or self.server.dicom}", "--called", called]

    def problems(self, file):
        return subprocess.run(["dciodvfy", file], capture_output=True, text=True).stderr

    def outbox(self, name):
        return self.folder / name

    def test_the_worklist_is_listed_and_entries_are_never_guessed(self):
        self.assertIn("answers as ARCHIVE", self.run_dicom("echo", *self.pacs()))
        listed = self.run_dicom("worklist", *self.pacs())
        for words in ("A1001", "Müller, Änne", "P-7", "1970-01-02", "07:05", "Diagnostic laparoscopy", "A1002"):
            self.assertIn(words, listed)
        self.assertNotIn("A0900", listed)
        self.assertIn("A0900", self.run_dicom("worklist", *self.pacs(), "--date", "all"))
        self.assertIn("no entries", self.run_dicom("worklist", *self.pacs(), "--modality", "CT"))
        box = self.outbox("guessed")
        wrap = ["wrap", self.files, "-o", box, *self.pacs()]
        self.assertIn("0 worklist entries", self.run_dicom(*wrap, "--entry", "A9", code=1))
        self.assertIn("there is no terminal to ask on", self.run_dicom(*wrap, code=1, stdin=subprocess.DEVNULL))
        self.assertFalse(box.exists())

    def test_objects_are_read_by_archive_validator_and_pydicom(self):
        box = self.outbox("whole")
        words = self.run_dicom("wrap", self.files, "-o", box, *self.pacs(), "--entry", "A1001", "--region", "abdomen")
        self.assertIn("5 objects in", words)
        self.assertIn("3 stills, 1 clips, measurements of 2 tables", words)
        names = sorted(os.listdir(box))
        self.assertTrue(all(name.startswith("2.25.") and name.endswith(".dcm") for name in names), names)
        self.assertEqual(box.stat().st_mode & 0o777, 0o700)
        for name in names:
            self.assertNotIn("Error", self.problems(box / name))
            self.assertEqual((box / name).stat().st_mode & 0o777, 0o600)
        self.assertIn("5 objects stored", self.run_dicom("send", box, *self.pacs()))
        self.assertEqual(os.listdir(box), [])
        stored = self.server.objects(STUDY)
        self.check_identity(stored)
        self.check_stills(stored[STILL])
        self.check_clip(stored[CLIP][0])
        self.check_report(stored[REPORT][0], stored[STILL])
        # What is exported again is the same object, which the archive keeps once.
        self.run_dicom("wrap", self.files, "-o", box, *self.pacs(), "--entry", "S1", "--region", "abdomen")
        self.assertEqual(sorted(os.listdir(box)), names)
        self.run_dicom("send", box, *self.pacs())
        self.assertEqual(sum(map(len, self.server.objects(STUDY).values())), 5)
        # Nothing of the patient is beside the outbox or in the names of files.
        for file in self.files.iterdir():
            self.assertNotIn("Müller".encode(), file.read_bytes())

    def check_identity(self, stored):
        objects = [one for of_class in stored.values() for one in of_class]
        self.assertEqual(len(objects), 5)
        for one in objects:
            self.assertEqual(
                (str(one.PatientName), one.PatientID, one.IssuerOfPatientID, one.PatientBirthDate, one.PatientSex),
                ("Müller^Änne", "P-7", "General Hospital", "19700102", "F"))
            self.assertEqual((one.StudyInstanceUID, one.AccessionNumber, one.StudyID), (STUDY, "A1001", "RP1"))
            self.assertEqual((one.StudyTime, one.ReferringPhysicianName), ("070500", "Referring^Doctor"))
        self.assertEqual(len({one.SOPInstanceUID for one in objects}), 5)
        self.assertEqual(len({one.SeriesInstanceUID for one in objects}), 3)

    def test_codes_mean_what_the_standard_says(self):
        seen = set()
        for region in ("abdomen", "pelvis", "chest", "joint", "head", "neck", "unknown"):
            box = self.outbox(f"codes_{region}")
            more = [] if region == "unknown" else ["--region", region]
            self.run_dicom("wrap", self.files, "-o", box, *self.pacs(), "--entry", "A1001", *more)
            for name in os.listdir(box):
                self.assertNotIn("Error", self.problems(box / name), region)
                for element in pydicom.dcmread(box / name).iterall():
                    if element.VR == "SQ":
                        seen.update((code.CodingSchemeDesignator, code.CodeValue, code.CodeMeaning) for code in element.value if "CodeValue" in code)
        of_standard = {code for code in seen if code[0] in ("SCT", "DCM")}
        self.assertGreaterEqual(len(of_standard), 14, seen)
        for scheme, value, meaning in of_standard:
            known = [names[value][0] for names in concepts[scheme].values() if value in names]
            self.assertIn(meaning, known, f"{scheme} {value}")

    def check_stills(self, stills):
        by_number = {int(one.InstanceNumber): one for one in stills}
        self.assertEqual(sorted(by_number), [1, 3, 4])
        np.testing.assert_array_equal(by_number[1].pixel_array, self.pixels)
        np.testing.assert_array_equal(by_number[3].pixel_array, self.gray)
        fragment = list(generate_fragments(by_number[4].PixelData))[-1]
        original = (self.files / "still_0004.jpg").read_bytes()
        self.assertEqual(fragment.rstrip(b"\0"), original.rstrip(b"\0"))
        self.assertEqual((by_number[4].LossyImageCompression, by_number[4].PhotometricInterpretation), ("01", "YBR_FULL_422"))

    def check_clip(self, clip):
        self.assertEqual(clip.file_meta.TransferSyntaxUID, "1.2.840.10008.1.2.4.102")
        self.assertEqual((clip.Rows, clip.Columns, int(clip.NumberOfFrames), int(clip.InstanceNumber)), (120, 160, 12, 2))
        fragments = list(generate_fragments(clip.PixelData))
        video = self.folder / "video.mp4"
        video.write_bytes(fragments[-1])
        theirs, ours = cv2.VideoCapture(str(video)), cv2.VideoCapture(str(self.files / "clip_0002.mkv"))
        count = 0
        while True:
            (more, picture), (_, original) = theirs.read(), ours.read()
            if not more:
                break
            count += 1
            difference = np.abs(picture.astype(int) - original.astype(int)).mean()
            self.assertLess(difference, 6, f"picture {count}")
        self.assertEqual(count, 12)
        self.assertAlmostEqual(float(clip.FrameTime) * 12 / 1000, float(clip.EffectiveDuration), 3)

    def check_report(self, report, stills):
        groups = [item for item in report.ContentSequence if item.ValueType == "CONTAINER"]
        items = [item for group in groups for item in group.ContentSequence]
        def value(item):
            measured = item.MeasuredValueSequence[0]
            unit = measured.MeasurementUnitsCodeSequence[0]
            name = item.ConceptNameCodeSequence[0].CodeMeaning
            return name, float(measured.NumericValue), unit.CodeValue, unit.CodingSchemeDesignator
        self.assertEqual([value(item) for item in items], [("Depth", 50.5, "mm", "UCUM"), ("Length", 12.25, "mm", "UCUM")])
        self.assertFalse("ContentSequence" in items[0], "its error is not known, and its picture is not named")
        error, ends = items[1].ContentSequence
        self.assertEqual(value(error), ("95 % error bound", 0.5, "mm", "UCUM"))
        self.assertEqual(list(ends.GraphicData), [10.5, 20.5, 50.5, 40.5])
        picture = ends.ContentSequence[0].ReferencedSOPSequence[0].ReferencedSOPInstanceUID
        self.assertEqual(picture, next(one for one in stills if one.InstanceNumber == 1).SOPInstanceUID)

    def test_nothing_is_lost_while_the_archive_is_down_or_refuses(self):
        box = self.outbox("kept")
        self.run_dicom("wrap", self.files / "still_0001.png", "-o", box, *self.pacs(), "--entry", "A1002")
        names = os.listdir(box)
        self.assertIn("cannot be reached", self.run_dicom("send", box, *self.pacs(port=free_port()), code=1))
        self.assertIn("refused the association", self.run_dicom("send", box, *self.pacs(called="WRONG"), code=1))
        self.assertEqual(os.listdir(box), names)
        # A file that is no object stays, and the others go.
        (box / "broken.dcm").write_bytes(b"no object")
        words = self.run_dicom("send", box, *self.pacs(), code=1)
        self.assertIn("broken.dcm", words)
        self.assertIn("1 objects stored", words)
        self.assertEqual(os.listdir(box), ["broken.dcm"])

    def test_an_archive_that_dies_loses_nothing(self):
        folder = self.folder / "dying"
        folder.mkdir()
        server, box = Orthanc(folder), self.outbox("dying-box")
        server.start()
        try:
            large = np.random.default_rng(1).integers(0, 256, (1500, 2000, 3), dtype=np.uint8)
            for number in range(6):
                large[0, 0] = number
                Image.fromarray(large).save(self.folder / f"large_{number}.png", compress_level=1)
            self.run_dicom("wrap", *(self.folder / f"large_{n}.png" for n in range(6)), "-o", box, *self.pacs(), "--entry", "A1002")
            to = ["--pacs", f"127.0.0.1:{server.dicom}", "--called", "ARCHIVE"]
            send = subprocess.Popen([PANOSCOPE, "dicom", "send", box, *to], stderr=subprocess.PIPE, text=True)
            until = time.monotonic() + 60
            while len(os.listdir(box)) == 6 and send.poll() is None and time.monotonic() < until:
                time.sleep(0.001)
            server.process.kill()
            server.process.wait()
            server.process = None
            send.communicate(timeout=120)
            left = len(os.listdir(box))
            server.start()
            stored = len(json.loads(server.get("/instances")))
            # An archive that is killed may lose what it has just confirmed; what it has not confirmed is still here.
            self.assertGreaterEqual(stored + left + 1, 6)
            self.run_dicom("send", box, *to)
            self.assertEqual(os.listdir(box), [])
        finally:
            server.stop()


if __name__ == "__main__":
    unittest.main()
