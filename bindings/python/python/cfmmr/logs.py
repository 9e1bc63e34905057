"""Logs and tables that the program writes."""

import csv
import json
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ._native import InputError
from .runs import Log


def read(path: str | PathLike[str]) -> Log | dict[str, Log]:
    """Reads a CSV table as a log; a folder of CSV tables, or an MCAP log, as a dict of logs by table or topic.

    Numbers that are missing are NaN. An MCAP log needs the package mcap (`pip install 'cfmmr[logs]'`). Its fields are
    columns as in a CSV table; fields without a number or a word of their own, such as lists of frames, are left out.
    """
    path = Path(path)
    if path.is_dir():
        tables = {table.stem: _csv(table) for table in sorted(path.glob("*.csv"))}
        if not tables:
            raise InputError(f"{path}: must be a folder with CSV tables")
        return tables
    if path.suffix.lower() == ".csv":
        return _csv(path)
    if path.suffix.lower() == ".mcap":
        return _mcap(path)
    raise InputError(f"{path}: must be a CSV table, a folder of tables, or an MCAP log")


def _csv(path: Path) -> Log:
    with open(path, newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    if not rows:
        raise InputError(f"{path}: must have a header")
    header, rows = rows[0], rows[1:]
    return Log.of({name: _column([row[k] for row in rows]) for k, name in enumerate(header)})


def _column(cells: list[Any]) -> np.ndarray:
    """Numbers, with NaN for an empty cell; words if a cell is not a number."""
    try:
        return np.array([float("nan") if cell in ("", None) else float(cell) for cell in cells])
    except (TypeError, ValueError):
        return np.array(["" if cell is None else str(cell) for cell in cells])


def _mcap(path: Path) -> dict[str, Log]:
    try:
        from mcap.reader import make_reader
    except ImportError as error:
        raise ImportError("an MCAP log needs the package mcap: pip install 'cfmmr[logs]'") from error
    topics: dict[str, list[dict[str, Any]]] = {}
    with open(path, "rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            if channel.message_encoding == "json":
                row = {"log_time_s": message.log_time * 1e-9}
                _flatten("", json.loads(message.data), row)
                topics.setdefault(channel.topic, []).append(row)
    logs = {}
    for topic, rows in topics.items():
        names = dict.fromkeys(name for row in rows for name in row)
        logs[topic] = Log.of({name: _column([row.get(name) for row in rows]) for name in names})
    return logs


def _flatten(name: str, value: Any, row: dict[str, Any]) -> None:
    """Adds a message's numbers and words to a row, under their paths."""
    if isinstance(value, dict):
        for key, inner in value.items():
            _flatten(f"{name}.{key}" if name else key, inner, row)
    elif isinstance(value, list):
        if all(isinstance(one, (int, float, list, type(None))) for one in value):
            for k, inner in enumerate(value):
                _flatten(f"{name}[{k}]", inner, row)
    else:
        row[name] = value
