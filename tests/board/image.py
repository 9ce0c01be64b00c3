"""What the emulated flash holds: MicroPython's image, and a file system with the firmware."""

from __future__ import annotations

import hashlib
import re
import struct
from dataclasses import dataclass
from pathlib import Path

from rigs.bench import firmware as installed

FLASH = 0x10000000
FLASH_BYTES = 2 * 1024 * 1024  # of a Raspberry Pi Pico
FILES_BYTES = 1408 * 1024  # at its end: MICROPY_HW_FLASH_STORAGE_BYTES of the port's RPI_PICO
FILES_AT = FLASH_BYTES - FILES_BYTES
BLOCK = 4096
BOOTROM_BYTES = 16384
UF2 = struct.Struct("<8I")
UF2_MAGIC = (0x0A324655, 0x9E5D5157)
UF2_RP2040 = 0xE48BFF56


class Unusable(Exception):
    """A file that was given, or a package that is missing; one line says what to do."""


@dataclass(frozen=True)
class Image:
    """MicroPython for the board, and what it says about itself."""

    content: bytes
    version: str
    sha256: str


def read_image(path: Path) -> Image:
    """Read a .uf2 or .bin image.

    Raises:
        Unusable: it is neither, not for the RP2040, or too long.
    """
    data = path.read_bytes()
    content = _from_uf2(data, path) if data[:4] == struct.pack("<I", UF2_MAGIC[0]) else data
    if not 0 < len(content) <= FILES_AT:
        raise Unusable(f"{path}: {len(content)} bytes, expected an image of up to {FILES_AT}")
    found = re.search(rb"MicroPython (v[0-9][\w.+-]*) on ([0-9-]+)", content)
    version = b"%b of %b" % found.groups() if found else b"unknown"
    return Image(content, version.decode(), hashlib.sha256(data).hexdigest())


def _from_uf2(data: bytes, path: Path) -> bytes:
    out = bytearray()
    for at in range(0, len(data), 512):
        first, second, flags, address, size, _, _, family = UF2.unpack_from(data, at)
        if (first, second) != UF2_MAGIC:
            raise Unusable(f"{path}: block {at // 512} is not UF2")
        if flags & 1 or family != UF2_RP2040:  # not for the main flash, or for another chip
            continue
        offset = address - FLASH
        if not 0 <= offset <= FILES_AT:
            raise Unusable(f"{path}: block for address {address:#x}")
        out.extend(b"\xff" * (offset + size - len(out)))
        out[offset : offset + size] = data[at + 32 : at + 32 + size]
    if not out:
        raise Unusable(f"{path}: no block for the RP2040")
    return bytes(out)


def read_bootrom(path: Path) -> str:
    """Version of a boot ROM: B0, B1, B2.

    Raises:
        Unusable: it is not the boot ROM of an RP2040.
    """
    data = path.read_bytes()
    if len(data) != BOOTROM_BYTES or data[0x10:0x13] != b"Mu\x01":
        raise Unusable(f"{path}: not the {BOOTROM_BYTES} bytes of an RP2040's boot ROM")
    return f"B{data[0x13] - 1}"


def filesystem(files: dict[str, bytes]) -> bytes:
    """A littlefs image as MicroPython's port makes it, with these files.

    Raises:
        Unusable: the package that writes it is missing.
    """
    try:
        from littlefs import LittleFS
    except ImportError:
        raise Unusable("no littlefs: `pip install littlefs-python`") from None
    made = LittleFS(
        block_size=BLOCK,
        block_count=FILES_BYTES // BLOCK,
        prog_size=256,
        read_size=32,
        lookahead_size=32,
        cache_size=1024,
    )
    folders: set[str] = set()
    for name, content in sorted(files.items()):
        parts = name.split("/")
        for depth in range(1, len(parts)):
            folder = "/".join(parts[:depth])
            if folder not in folders:
                made.mkdir(folder)
                folders.add(folder)
        with made.open(name, "wb") as file:
            file.write(content)
    return bytes(made.context.buffer)


def firmware() -> dict[str, bytes]:
    """What ``pamrig firmware install`` puts on a board."""
    return installed.board_files()


def compiled(name: str) -> bytes:
    """A file of the firmware's source that does not belong on a board, compiled like the others."""
    return installed.compiled(installed.SOURCE / name)


def symbols(path: Path, names: set[str]) -> dict[str, int]:
    """Addresses of functions in an ELF file.

    Raises:
        Unusable: it is no such file, or has not all of them.
    """
    data = path.read_bytes()
    if data[:5] != b"\x7fELF\x01":
        raise Unusable(f"{path}: not a 32-bit ELF file")
    (sections_at,) = struct.unpack_from("<I", data, 0x20)
    size, number = struct.unpack_from("<HH", data, 0x2E)
    sections = [struct.unpack_from("<10I", data, sections_at + k * size) for k in range(number)]
    found = {}
    for section in sections:
        if section[1] != 2:  # a table of symbols
            continue
        strings = sections[section[6]][4]
        for at in range(section[4], section[4] + section[5], 16):
            name_at, value = struct.unpack_from("<II", data, at)
            name = data[strings + name_at : data.index(b"\x00", strings + name_at)].decode()
            if name in names:
                found[name] = value
    if names - found.keys():
        raise Unusable(f"{path}: no symbols {', '.join(sorted(names - found.keys()))}")
    return found
