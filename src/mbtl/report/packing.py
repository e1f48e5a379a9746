"""Numbers inside a page: a JSON header and one block of bytes, compressed together.

Large arrays are quantised to 16 bits, or to 8 where there are very many entries: a picture shows
no more, and hovering shows four digits of the first and two of the second.

    4 bytes  length of the header
             the header (UTF-8), with spaces to a multiple of 8
             the arrays, each from a multiple of 8
"""

from __future__ import annotations

import base64
import gzip
import json
from typing import Any

import numpy as np

from mbtl.arrays import plain

_MANY = 1_500_000
"""Entries beyond which one byte each has to do."""


def packed(content: Any) -> str:
    """Nested dicts and lists with arrays in them -> text for a page; NaN become null."""
    blocks: list[bytes] = []
    told = plain(content, lambda values: _array(values, blocks))
    header = json.dumps(told, allow_nan=False, separators=(",", ":")).encode()
    start = len(header).to_bytes(4, "little") + header
    start += b" " * (-len(start) % 8)
    return compressed(start + b"".join(blocks))


def compressed(data: bytes) -> str:
    """Bytes as the text that the page unpacks."""
    return base64.b64encode(gzip.compress(data, 9, mtime=0)).decode("ascii")


def quantised(values: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Codes of the values, and what the first and last code but one mean; the last is NaN."""
    known = np.isfinite(values)
    low, high = (float(f(values[known])) if known.any() else 0.0 for f in (np.min, np.max))
    kind, top = (np.uint8, 254) if values.size > _MANY else (np.uint16, 65534)
    share = (np.where(known, values, low) - low) / ((high - low) or 1.0)
    codes = np.where(known, np.round(share * top), top + 1).astype(kind)
    return codes, low, high


def _array(values: np.ndarray, blocks: list[bytes]) -> dict[str, Any]:
    start = sum(map(len, blocks))
    record: dict[str, Any] = {"$": start, "shape": list(values.shape)}
    if values.dtype.kind in "iub":
        data = values.astype("<i4").tobytes()
        record["type"] = "i4"
    elif values.ndim == 1:  # axes and curves stay exact
        data = values.astype("<f8").tobytes()
        record["type"] = "f8"
    else:
        codes, record["low"], record["high"] = quantised(values.astype(np.float64))
        data, record["type"] = codes.tobytes(), f"u{codes.itemsize}"
    blocks.append(data + b"\0" * (-len(data) % 8))
    return record
