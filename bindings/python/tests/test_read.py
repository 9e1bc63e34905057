"""Logs and tables of the program."""

import subprocess

import numpy as np
import pytest

import cfmmr
from cfmmr import InputError, read, run


@pytest.fixture(scope="module")
def files(program, tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    command = [program, "posture", "--trials", "1", "--seed", "31", "--rows", "joint", "--out", folder / "out"]
    for output in (["--csv", folder / "csv"], ["--log", folder / "run.mcap"], ["--csv", folder / "epochs.csv"]):
        subprocess.run([*command, *output], check=True, capture_output=True)
    return folder


@pytest.fixture(scope="module")
def log(files, careful):
    """The run that the program has logged."""
    length = len(read(files / "epochs.csv")["time_s"])
    logs = [run(row, 31)[0] for row in careful.rows("joint")]
    return next(log for log in logs if len(log["time_s"]) == length)


def test_csv_of_epochs_is_the_log(files, log):
    found = read(files / "epochs.csv")
    assert list(found) == list(log)
    assert all(
        np.array_equal(found[name], log[name], equal_nan=found[name].dtype.kind == "f")
        for name in log
        if found[name].dtype.kind == log[name].dtype.kind != "U"
    )
    assert found["lead.robot.covariance"].shape == (len(log["time_s"]), 3, 3)


def test_folder_of_tables_is_a_dict_of_logs(files, log):
    tables = read(files / "csv")
    epochs = next(table for table in tables.values() if "lead.robot" in table)
    assert np.array_equal(epochs["lead.robot"], log["lead.robot"])
    assert len(tables) >= 2 and all(isinstance(table, cfmmr.Log) for table in tables.values())


@pytest.mark.parametrize("topic", ["lead", "truth"])
def test_mcap_log_holds_the_run(files, log, topic):
    found = read(files / "run.mcap")[f"/{topic}"]
    compared = 0
    for name, column in found.items():
        wanted = log.get(f"{topic}.{name}")
        if wanted is not None and wanted.dtype.kind == "f" and wanted.shape[1:] == column.shape[1:]:
            # The log has the shortest digits of a number in single precision.
            single = np.array_equal(wanted, wanted.astype("f4"), equal_nan=True)
            column = column.astype("f4") if single else column
            assert np.array_equal(column[: len(wanted)], wanted, equal_nan=True), name
            compared += 1
    assert compared > 5 and {"robot"} <= set(found) and len(found["robot"]) >= len(log["time_s"])


@pytest.mark.parametrize("name", ["missing", "text.txt", "empty"])
def test_what_is_no_log_is_refused(tmp_path, name):
    (tmp_path / "text.txt").write_text("a,b\n1,2\n")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=name):
        read(tmp_path / name)


def test_csv_without_header_is_refused(tmp_path):
    (tmp_path / "empty.csv").write_text("")
    with pytest.raises(InputError, match="header"):
        read(tmp_path / "empty.csv")


def test_words_and_missing_numbers_of_a_table(tmp_path):
    (tmp_path / "a.csv").write_text("n,word,m[0],m[1]\n1,a,3,4\n,b,5,6\n")
    table = read(tmp_path / "a.csv")
    assert np.isnan(table["n"][1]) and table["word"].tolist() == ["a", "b"]
    assert table["m"].tolist() == [[3, 4], [5, 6]]
