"""Errors of the command line, and a search for errors without an example."""
import re
import shlex
import shutil
import tomllib
from pathlib import Path

from bench import Case, Kind, Unsound

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
PACKAGES = [ROOT / "host-sim", *(ROOT / "crates" / name for name in ["output", "remote", "recording", "view", "cfmmr"])]
LITERAL = re.compile(r'"((?:[^"\\]|\\.)*)"', re.S)
# Length of the part of a message that must occur in an example: shorter parts are common to several messages.
ENOUGH = 14


def joined(text):
    """Source text in which string literals over several lines are joined."""
    return re.sub(r"\\\n\s*", "", text)


def argument(text, begin):
    """Text from `begin` to the closing parenthesis; parentheses in strings do not count."""
    depth, at = 1, begin
    while depth and at < len(text):
        literal = LITERAL.match(text, at)
        depth += {"(": 1, ")": -1}.get(text[at], 0) if not literal else 0
        at = literal.end() if literal else at + 1
    return text[begin:at]


def sources():
    """Sources of the program without their tests, by path, and the text of all tests."""
    tests = "".join(joined(path.read_text()) for package in PACKAGES for path in package.glob("tests/**/*.rs"))
    found = {}
    for path in sorted(path for package in PACKAGES for path in package.glob("src/**/*.rs")):
        text, _, own = path.read_text().partition("#[cfg(test)]")
        tests += joined(own)
        if path.name == "tests.rs" or "tests" in path.parts:
            tests += joined(text)
        else:
            found[path.relative_to(ROOT)] = text
    return found, tests


def messages():
    """Place and constant parts of each error message."""
    found, tests = sources()
    for path, text in found.items():
        for site in re.finditer(r"Error::(?:[iI]nput|Failure)\(", text):
            literals = LITERAL.findall(joined(argument(text, site.end())))
            parts = [part.strip(" :;,.") for literal in literals for part in re.split(r"\{[^}]*\}", literal)]
            parts = [part.replace('\\"', '"') for part in parts if len(part) >= ENOUGH // 2]
            if parts:
                yield f"{path}:{text[:site.start()].count(chr(10)) + 1}", parts, tests


def is_in(part, text):
    starts = range(0, max(1, len(part) - ENOUGH + 1))
    return any(part[start : start + ENOUGH] in text for start in starts)


class Messages(Kind):
    """Each message that the command line can provoke."""

    name = "messages"

    def prepare(self):
        table = tomllib.loads((HERE / "messages.toml").read_text())
        self.table = table["message"]
        listed = "\n".join([one["says"] for one in self.table] + [text for texts in table["elsewhere"].values() for text in texts])
        missing = [
            f"{place} \"{parts[0]}\""
            for place, parts, tests in messages()
            if not any(is_in(part, tests) or is_in(part, listed) for part in parts)
        ]
        if missing:
            raise Unsound(f"messages without an example: {'; '.join(missing)}")
        for log, more in [("run.mcap", ""), ("unencoded.mcap", "--set bus.quantise=false")]:
            self.sound(*f"follow --path circle --size 0.4 --log {log} --out out {more}".split())

    def total(self, times):
        return len(self.table)

    def case(self, rng, index, folder):
        one = self.table[index]
        for name, content in one.get("files", {}).items():
            (folder / name).write_text(content)
        for log in self.folder.glob("*.mcap"):
            shutil.copy(log, folder)
        words = re.escape(one["says"]).replace(r"\ ", r"\s+")
        return Case(
            shlex.split(one["command"]), codes=(2,), refuse="a wrong command", named=words,
            stdin=one.get("input", "").encode(),
        )
