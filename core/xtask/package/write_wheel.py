"""Writes a wheel: every file of a folder, and the list of them with their hashes. `python3 write_wheel.py FOLDER FILE.whl SECONDS`.

The same files give the same bytes: members are in the order of their names, and all have the time SECONDS since 1970.
"""

import base64
import hashlib
import sys
import time
import zipfile
from pathlib import Path

folder, wheel, seconds = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])
# A zip cannot say a time before 1980.
when = time.gmtime(max(seconds, 315532800))[:6]
record = f"{next(folder.glob('*.dist-info')).name}/RECORD"


def add(archive: zipfile.ZipFile, name: str, content: bytes, mode: int) -> None:
    member = zipfile.ZipInfo(name, when)
    member.external_attr = (0o100000 | mode) << 16
    member.compress_type = zipfile.ZIP_DEFLATED
    archive.writestr(member, content, compresslevel=6)


lines = []
part = wheel.with_name(wheel.name + ".part")
with zipfile.ZipFile(part, "w") as archive:
    for file in sorted(path for path in folder.rglob("*") if path.is_file()):
        name, content = file.relative_to(folder).as_posix(), file.read_bytes()
        add(archive, name, content, 0o755 if file.stat().st_mode & 0o100 else 0o644)
        digest = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()
        lines.append(f"{name},sha256={digest},{len(content)}\n")
    add(archive, record, ("".join(lines) + f"{record},,\n").encode(), 0o644)
part.replace(wheel)
