"""Lines, cells and numbers of text files as laboratories write them."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path

from flexapod.core.errors import InputError

UNIT_IN_BRACKETS = re.compile(r"[\(\[]\s*([^\)\]]*?)\s*[\)\]]")
_NUMBER = re.compile(r"^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$")


def read_lines(path: Path) -> list[str]:
    """Lines of a text file: UTF-8, UTF-16 or Windows."""
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", str(path)) from None
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        text = raw.decode("utf-16", errors="replace")
    else:
        try:
            text = raw.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = raw.decode("cp1252", errors="replace")
    if not text.strip():
        raise InputError("is empty", str(path))
    return text.splitlines()


def split_cells(line: str, delimiter: str) -> list[str]:
    """Cells of a line without quotes and blanks around them."""
    row = next(csv.reader(io.StringIO(line), delimiter=delimiter), [])
    return [cell.strip().strip('"').strip() for cell in row]


def parse_number(cell: str) -> float | None:
    """A number with decimal point or comma; thousands may be marked with the other or a space."""
    text = cell.replace("\u00a0", "").replace(" ", "").replace("\u2212", "-")
    if "," in text:
        if "." in text:
            # The later mark is the decimal one: 1.234,5 and 1,234.5.
            text = (
                text.replace(".", "").replace(",", ".")
                if text.rfind(",") > text.rfind(".")
                else text.replace(",", "")
            )
        else:
            text = text.replace(",", ".")
    return float(text) if _NUMBER.match(text) else None
