"""FMU archives that are made to do harm, built from plain text when they are needed."""

import struct
import zipfile
import zlib
from pathlib import Path

HEAD = (
    '<fmiModelDescription fmiVersion="2.0" modelName="M" guid="{g}">\n<ModelExchange modelIdentifier="m"/>\n'
)
TAIL = "<ModelStructure/>\n</fmiModelDescription>"
REAL = '<ScalarVariable name="NAME" valueReference="NUMBER"><Real/></ScalarVariable>\n'
DESCRIPTION = "modelDescription.xml"


def variables(pairs) -> str:
    """A description with variables of these names and value references."""
    rows = "".join(REAL.replace("NAME", name).replace("NUMBER", str(number)) for name, number in pairs)
    return f"{HEAD}<ModelVariables>\n{rows}</ModelVariables>\n{TAIL}"


def archive(path: Path, members: dict[str, bytes | str]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as opened:
        for name, content in members.items():
            opened.writestr(name, content)
    return path


def described(path: Path, text: str) -> Path:
    return archive(path, {DESCRIPTION: text})


def liar(path: Path, name: str, size: int, stated: int) -> Path:
    """An archive whose directory states other sizes than its member `name` of zeros has."""
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    megabyte = packer.compress(bytes(1 << 20)) + packer.flush(zlib.Z_FULL_FLUSH)  # can be repeated
    content, title = megabyte * (size >> 20) + packer.flush(), name.encode()
    fields = (20, 0, 8, 0, 0, 0, len(content), stated, len(title))
    local = struct.pack("<4sHHHHHIIIHH", b"PK\3\4", *fields, 0) + title + content
    entry = struct.pack("<4sHHHHHHIIIHHHHHII", b"PK\1\2", 20, *fields, 0, 0, 0, 0, 0, 0) + title
    end = struct.pack("<4sHHHHIIH", b"PK\5\6", 0, 0, 1, 1, len(entry), len(local), 0)
    path.write_bytes(local + entry + end)
    return path


def long_directory(path: Path, n: int) -> Path:
    """An archive that is a list of `n` members."""
    title = b"x" * 40
    entry = struct.pack("<4sHHHHHHIIIHHHHHII", b"PK\1\2", 20, 20, 0, 0, 0, 0, 0, 0, 0, 40, 0, 0, 0, 0, 0, 0)
    size = n * len(entry + title)
    record = struct.pack("<4sQHHIIQQQQ", b"PK\6\6", 44, 45, 45, 0, 0, n, n, size, 0)
    locator = struct.pack("<4sIQI", b"PK\6\7", 0, size, 1)
    end = struct.pack("<4sHHHHIIH", b"PK\5\6", 0, 0, 65535, 65535, 0xFFFFFFFF, 0xFFFFFFFF, 0)
    with path.open("wb") as stream:
        for _ in range(n):
            stream.write(entry + title)
        stream.write(record + locator + end)
    return path


def deep(n: int) -> str:
    return f"{HEAD}<ModelVariables>{'<a>' * n}{'</a>' * n}</ModelVariables>{TAIL}"
