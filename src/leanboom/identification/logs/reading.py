"""Logs of a machine as arrays in SI units: CSV and MATLAB files, and with their extras MDF4 and MCAP."""

from __future__ import annotations

import csv
import hashlib
import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from leanboom.errors import InputError
from leanboom.identification.logs.channels import TIME, Column, match
from leanboom.model.machine import Machine

LEAST_ROWS = 200
EXTRA = "pip install 'leanboom[logs]'"


@dataclass(frozen=True, slots=True, eq=False)
class Log:
    """A log as it was written, in SI units. Cells that are empty or no number are NaN."""

    file: str  # as shown in messages
    digest: str  # SHA-256 of the file, in hexadecimal digits
    first_row: int  # number of the first sample's row in the file, from 1
    time: np.ndarray  # [s], (rows,)
    signals: Mapping[str, np.ndarray]  # by channel, (rows,) each
    columns: Mapping[str, Column]

    def row(self, sample: int) -> int:
        """The row of a sample in the file, from 1."""
        return self.first_row + int(sample)


def read_log(path: Path, machine: Machine, named: Mapping[str, Mapping[str, Any]]) -> Log:
    """Read a log.

    Args:
        path: The file: .csv, .mat, .mf4 or .mcap.
        machine: The machine whose channels are sought.
        named: A column map, see `channels.read_map`.

    Raises:
        InputError: It cannot be read, or does not hold what is needed.
    """
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise InputError(f"log = {path}; must end in {', '.join(_READERS)}")
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"log = {path}; cannot be read: {error.strerror}") from None
    table, first = reader(path, content)
    columns = match(tuple(table), machine, named, str(path))
    values = {
        channel: np.ascontiguousarray(column.factor * (table[column.name] - column.zero))
        for channel, column in columns.items()
    }
    time = values.pop(TIME)
    if time.size < LEAST_ROWS:
        raise InputError(f"{path}: has {time.size} rows; must have at least {LEAST_ROWS}")
    if not values:
        raise InputError(f"{path}: no column but the time is known; give a column map with --columns")
    return Log(str(path), hashlib.sha256(content).hexdigest(), first, time, values, columns)


def _csv(path: Path, content: bytes) -> tuple[dict[str, np.ndarray], int]:
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not UTF-8 text") from None
    lines = text.splitlines()
    if not lines:
        raise InputError(f"{path}: is empty")
    delimiter = max(",;\t", key=lines[0].count)
    headers = [name.strip() for name in next(csv.reader([lines[0]], delimiter=delimiter))]
    twice = {name for name in headers if headers.count(name) > 1}
    if twice:
        raise InputError(f"{path}: column {sorted(twice)[0]} is there twice")
    if len(lines) < 2:
        raise InputError(f"{path}: has no rows below its header")
    try:
        values = np.loadtxt(io.StringIO("\n".join(lines[1:])), delimiter=delimiter, ndmin=2)
    except ValueError:
        values = _patient(path, lines[1:], delimiter, len(headers))
    if values.shape[1] != len(headers):
        raise InputError(f"{path}: has {len(headers)} columns in its header and {values.shape[1]} below it")
    return {name: values[:, i] for i, name in enumerate(headers)}, 2


def _patient(path: Path, lines: list[str], delimiter: str, count: int) -> np.ndarray:
    """A table cell by cell: what is empty, or no number, becomes NaN."""
    rows = np.full((len(lines), count), np.nan)
    for i, cells in enumerate(csv.reader(lines, delimiter=delimiter)):
        if cells and len(cells) != count:
            raise InputError(f"{path}: row {i + 2} has {len(cells)} cells; must have {count} as the header")
        for j, cell in enumerate(cells):
            try:
                rows[i, j] = float(cell)
            except ValueError:
                continue
    rows[~np.isfinite(rows)] = np.nan
    empty = np.isnan(rows).all(axis=0)
    if empty.all():
        comma = " (a decimal comma? write decimal points)" if delimiter == ";" else ""
        raise InputError(f"{path}: holds no numbers below its header{comma}")
    return rows


def _mat(path: Path, content: bytes) -> tuple[dict[str, np.ndarray], int]:
    from scipy.io import loadmat

    try:
        found = loadmat(io.BytesIO(content), squeeze_me=True, struct_as_record=False)
    except NotImplementedError:
        raise InputError(f"{path}: is a MATLAB 7.3 file; save it with -v7") from None
    except Exception as error:
        raise InputError(f"{path}: is no MATLAB file: {error}") from None
    table: dict[str, np.ndarray] = {}
    for name, value in found.items():
        if not name.startswith("__"):
            parts = {f: getattr(value, f) for f in getattr(value, "_fieldnames", ())} or {name: value}
            for part, numbers in parts.items():
                array = np.asarray(numbers)
                if array.ndim == 1 and array.dtype.kind in "fiub":
                    table[part] = array.astype(np.float64)
    return _same_length(path, table)


def _mdf(path: Path, content: bytes) -> tuple[dict[str, np.ndarray], int]:
    asammdf = _extra("asammdf", path)
    try:
        with asammdf.MDF(io.BytesIO(content)) as file:
            signals = [signal for signal in file.iter_channels(skip_master=True) if signal.samples.dtype.kind in "fiub"]
    except Exception as error:
        raise InputError(f"{path}: is no MDF file: {error}") from None
    sources = {
        f"{s.name} [{s.unit}]" if s.unit else s.name: (s.timestamps, s.samples.astype(np.float64)) for s in signals
    }
    return _on_one_time(path, sources)


def _mcap(path: Path, content: bytes) -> tuple[dict[str, np.ndarray], int]:
    """Numbers of JSON and ROS 2 messages, named by topic and field: `/lift.pressure_a`; names in lists by `name`."""
    reader = _extra("mcap.reader", path)
    factories = []
    try:
        factories.append(import_module("mcap_ros2.decoder").DecoderFactory())
    except ImportError:
        pass
    rows: dict[str, tuple[list[float], list[float]]] = {}
    import json

    try:
        source = reader.make_reader(io.BytesIO(content), decoder_factories=factories)
        for schema, channel, message in source.iter_messages():
            if channel.message_encoding == "json":
                value = json.loads(message.data)
            else:
                value = next((f.decoder_for(channel.message_encoding, schema)(message.data) for f in factories), None)
            for name, number in _numbers(channel.topic, value):
                times, numbers = rows.setdefault(name, ([], []))
                times.append(1e-9 * message.log_time)
                numbers.append(number)
    except Exception as error:
        raise InputError(f"{path}: is no MCAP file of JSON or ROS 2 messages: {error}") from None
    start = min((times[0] for times, _ in rows.values()), default=0.0)
    return _on_one_time(path, {n.removeprefix("/"): (np.array(t) - start, np.array(v)) for n, (t, v) in rows.items()})


def _numbers(name: str, value: Any) -> list[tuple[str, float]]:
    """All numbers in a message by their dotted names."""
    if isinstance(value, bool) or value is None or isinstance(value, str):
        return []
    if isinstance(value, int | float):
        return [(name, float(value))]
    if isinstance(value, dict):
        parts = value
    elif isinstance(value, list | tuple):
        parts = dict(enumerate(value))
    else:
        parts = {slot: getattr(value, slot) for slot in getattr(value, "__slots__", ())}
    return [pair for key, part in parts.items() for pair in _numbers(f"{name}.{key}", part)]


def _on_one_time(path: Path, sources: dict[str, tuple[np.ndarray, np.ndarray]]) -> tuple[dict[str, np.ndarray], int]:
    """Signals of several rates on the times of the fastest, within what all cover."""
    sources = {name: pair for name, pair in sources.items() if pair[0].size > 1}
    if not sources:
        raise InputError(f"{path}: holds no signals over time")
    fastest = max(sources.values(), key=lambda pair: pair[0].size)[0]
    begin, end = max(t[0] for t, _ in sources.values()), min(t[-1] for t, _ in sources.values())
    time = fastest[(fastest >= begin) & (fastest <= end)]
    return {"time": time, **{name: np.interp(time, t, v) for name, (t, v) in sources.items()}}, 1


def _same_length(path: Path, table: dict[str, np.ndarray]) -> tuple[dict[str, np.ndarray], int]:
    sizes = [array.size for array in table.values()]
    if not sizes:
        raise InputError(f"{path}: holds no vectors of numbers")
    most = max(sizes)
    return {name: array for name, array in table.items() if array.size == most}, 1


def _extra(module: str, path: Path) -> Any:
    try:
        return import_module(module)
    except ImportError:
        name = module.split(".", maxsplit=1)[0]
        raise InputError(f"{path}: reading it needs the package {name}; install it with: {EXTRA}") from None


_READERS: dict[str, Callable[[Path, bytes], tuple[dict[str, np.ndarray], int]]] = {
    ".csv": _csv, ".mat": _mat, ".mf4": _mdf, ".mcap": _mcap,
}  # fmt: skip
