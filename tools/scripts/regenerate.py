#!/usr/bin/env python3
"""Regenerate every picture, table and number of README and docs that comes from a run.

docs/manifest.toml names the commands and the destinations of each entry; docs/manifest.lock contains
hashes of the committed state. In a page, a table is between two marker lines, a number in a sentence
between two markers:

    <!-- figure NAME -->
    <!-- /figure -->

    tools/scripts/regenerate.py                 regenerate entries that are outdated or were edited by hand
    tools/scripts/regenerate.py --all           regenerate all entries except those measured on a date
    tools/scripts/regenerate.py NAME...         regenerate these entries
    tools/scripts/regenerate.py --accept NAME   keep the text of an entry that was measured or is checked elsewhere
    tools/scripts/regenerate.py --check         exit 1 and print the command to type if anything is stale

`--check` recomputes quick entries. For other entries it compares text and pictures with the lock, and runs
the probe: a short version of the command, whose raw results change when those of the command change.
Needs target/release/cfmmr and Python 3.11.
"""

import argparse
import contextlib
import difflib
import hashlib
import json
import math
import os
import pathlib
import re
import subprocess
import sys
import tempfile
import time
import tomllib
import types

ROOT = pathlib.Path(__file__).resolve().parents[2]
MARKER = re.compile(r"<!-- figure ([\w-]+) -->(.*?)<!-- /figure -->", re.DOTALL)
# Keys of an entry; see the head of docs/manifest.toml.
KEYS = {"command", "probe", "quick", "measured", "checked", "sources", "tolerance", "volatile", "define",
        "page", "pictures", "text"}


class Stale(Exception):
    """The committed state of an entry differs from that of this version, or the entry cannot be computed."""


def digest(*parts):
    total = hashlib.sha256()
    for part in parts:
        data = part if isinstance(part, bytes) else str(part).encode()
        total.update(len(data).to_bytes(8, "little") + data)
    return total.hexdigest()[:16]


# Functions for templates, in addition to the results of the run.

def pick(rows, **wanted):
    """Only row with these values."""
    found = [row for row in rows if all(getattr(row, key) == value for key, value in wanted.items())]
    if len(found) != 1:
        raise LookupError(f"{len(found)} rows with {wanted}")
    return found[0]


def spread(summary, scale, digits):
    return f"{scale * summary.mean:.{digits}f} ± {scale * summary.sd:.{digits}f}"


def rms(values):
    values = list(values)
    return math.sqrt(sum(value * value for value in values) / len(values))


def thousands(number, digits=2):
    text = f"{number:,.{digits if number < 1000 else 0}f}"
    return text.replace(",", " " if number >= 1e4 else "")


def lines(items):
    return "\n".join(items)


HELPERS = {"pick": pick, "spread": spread, "rms": rms, "thousands": thousands, "lines": lines,
           "degrees": math.degrees}


def without_run(text):
    """Result without the description of its run, because version, build and commit differ."""
    result = json.loads(text)
    if isinstance(result, dict):
        result.pop("run", None)
    return json.dumps(result, indent=2)


@contextlib.contextmanager
def output_of(commands, volatile):
    with tempfile.TemporaryDirectory(prefix="regenerate-") as folder:
        yield Output(commands, volatile, pathlib.Path(folder))


class Output:
    """Output of the commands of an entry."""

    def __init__(self, commands, volatile, path):
        search = f"{ROOT / 'target' / 'release'}:{os.environ['PATH']}"
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", commands], cwd=ROOT, stdout=subprocess.PIPE,
            env=os.environ | {"OUT": str(path), "PATH": search},
        )
        if done.returncode != 0:
            raise Stale(f"exit code {done.returncode} of:\n{commands.strip()}")
        self.path, self.stdout = path, done.stdout.decode()
        # Results by their path in $OUT without the file name: `run/result.json` is `out["run"]`.
        self.files = sorted(path.rglob("result*.json"))
        self.volatile = volatile

    def results(self):
        names = {}
        for file in self.files:
            name = str(file.relative_to(self.path).with_suffix("")).removesuffix("/result")
            text = file.read_text()
            names[name] = json.loads(text, object_hook=lambda keys: types.SimpleNamespace(**keys))
        return names

    def read(self, file):
        return (self.path / file).read_text()

    def raw(self, pictures, page):
        """Raw results whose changes must be detected."""
        texts = [without_run(file.read_text()) for file in self.files]
        if page or not texts:
            texts.append(self.stdout)
        for pattern in self.volatile:
            texts = [re.sub(pattern, "", text, flags=re.MULTILINE) for text in texts]
        files = [self.path / name for name in pictures]
        return texts + [file.read_bytes() for file in files if file.exists()]


class Entry:
    def __init__(self, name, keys, root):
        self.name, self.root = name, root
        unknown = keys.keys() - KEYS
        if unknown:
            sys.exit(f"regenerate.py: {name}: unknown key {', '.join(sorted(unknown))}")
        self.keys = keys
        self.command = keys["command"]
        self.probe = keys.get("probe")
        self.quick = keys.get("quick", False)
        self.tolerance = keys.get("tolerance", 0)
        # True if measured on a date: another run gives other numbers.
        self.measured = keys.get("measured", False)
        # The test that compares the destination with a run of this version.
        self.checked = keys.get("checked")
        self.page = keys.get("page")
        self.pictures = keys.get("pictures", {})
        self.texts = keys.get("text", {})
        ways = [self.probe, self.quick, self.measured, self.checked]
        if sum(map(bool, ways)) != 1:
            sys.exit(f"regenerate.py: {name}: exactly one of probe, quick, measured, checked")

    def by_hand(self):
        return not self.page and not self.pictures and all("is" not in text for text in self.texts.values())

    def read(self, file):
        return (self.root / file).read_text()

    def committed(self):
        """Destination -> committed content."""
        found = {}
        if self.page:
            found[self.page] = self.read(self.page)
        for file in self.pictures.values():
            path = self.root / file
            found[file] = path.read_bytes() if path.exists() else b""
        for figure, text in self.texts.items():
            for file in text["in"]:
                bodies = [body for name, body in MARKER.findall(self.read(file)) if name == figure]
                if not bodies:
                    raise Stale(f"{file} has no <!-- figure {figure} -->")
                if any(body != bodies[0] for body in bodies):
                    raise Stale(f"{file}: the places of {figure} differ")
                found[f"{file}: {figure}"] = bodies[0]
        return found

    def computed(self, output):
        """Destination -> content computed from this output."""
        found = {}
        if self.page:
            found[self.page] = output.stdout
        for source, file in self.pictures.items():
            path = output.path / source
            if not path.exists():
                raise Stale(f"the command writes no {source}")
            found[file] = path.read_bytes()
        names = HELPERS | {"out": output.results(), "stdout": output.stdout, "read": output.read}
        exec(self.keys.get("define", ""), names)
        for figure, text in self.texts.items():
            # The template is an f-string whose fields are expressions over the results.
            try:
                body = eval(f'rf"""{text["is"]}"""', names)
            except (LookupError, AttributeError) as error:
                raise Stale(f"{figure}: the template does not fit the results: {error!r}") from error
            body = f"\n{body.strip()}\n" if "\n" in body else body
            found |= {f"{file}: {figure}": body for file in text["in"]}
        return found

    def write(self, contents):
        for place, content in contents.items():
            file, _, figure = place.partition(": ")
            path = self.root / file
            if figure:
                def put(match, figure=figure, content=content):
                    return match[0] if match[1] != figure else f"<!-- figure {figure} -->{content}<!-- /figure -->"
                content = MARKER.sub(put, path.read_text())
            temporary = path.with_name(path.name + ".new")
            temporary.write_bytes(content if isinstance(content, bytes) else content.encode())
            temporary.replace(path)

    def run(self, commands):
        return output_of(commands, self.keys.get("volatile", []))

    def inputs(self):
        """Hash of the inputs of the destinations: this entry and the raw results of its probe."""
        parts = [json.dumps(self.keys, sort_keys=True)]
        if sources := self.keys.get("sources"):
            listed = subprocess.run(["git", "ls-files", "--", *sources], cwd=ROOT, stdout=subprocess.PIPE, check=True)
            parts += [(ROOT / file).read_bytes() for file in listed.stdout.decode().split()]
        if self.probe:
            with self.run(self.probe) as output:
                parts += output.raw(self.pictures, self.page)
        return digest(*parts)

    def outputs(self, contents=None):
        contents = self.committed() if contents is None else contents
        return digest(*(part for item in sorted(contents.items()) for part in item))

    def check(self, lock, edits_only=False):
        """Raises Stale if the entry is outdated or was edited by hand."""
        committed = self.committed()
        if not self.quick or self.tolerance:
            if self.name not in lock:
                raise Stale("not in docs/manifest.lock")
            inputs, outputs = lock[self.name]
            if outputs != self.outputs(committed):
                raise Stale("edited by hand: " + ", ".join(committed))
        if edits_only:
            return
        if self.quick:
            with self.run(self.command) as output:
                computed = self.computed(output)
            for place, content in computed.items():
                if not alike(committed[place], content, self.tolerance):
                    raise Stale(f"{place} is not what the command gives\n{difference(committed[place], content)}")
        elif inputs != self.inputs():
            raise Stale("another result or an edited entry: " + ", ".join(committed))

    def regenerate(self):
        with self.run(self.command) as output:
            self.write(self.computed(output))


def alike(committed, computed, tolerance):
    """True if two contents are equal except for number differences within the relative tolerance."""
    if committed == computed or not tolerance:
        return committed == computed
    number = re.compile(r"\d+\.?\d*")
    if number.sub("", committed) != number.sub("", computed):
        return False
    pairs = zip(number.findall(committed), number.findall(computed))
    return all(abs(float(a) - float(b)) <= tolerance * float(b) for a, b in pairs)


def difference(committed, computed):
    if isinstance(committed, bytes):
        return "the picture is another"
    pairs = difflib.unified_diff(committed.splitlines(), computed.splitlines(), "committed", "computed", "", "", 0)
    return "\n".join(pairs)


class Manifest:
    def __init__(self, root):
        self.root = root
        self.path = root / "docs" / "manifest.lock"
        table = tomllib.loads((root / "docs" / "manifest.toml").read_text())
        self.entries = {name: Entry(name, keys, root) for name, keys in table.items()}
        self.lock = {}
        if self.path.exists():
            rows = [line.split() for line in self.path.read_text().splitlines()]
            self.lock = {name: (inputs, outputs) for name, _, inputs, _, outputs in rows}

    def stray(self):
        """Pictures and markers without an entry, and markers that a page would show as text."""
        entries = self.entries.values()
        pictures = {file for entry in entries for file in entry.pictures.values()}
        figures = {(figure, file) for entry in entries for figure, text in entry.texts.items() for file in text["in"]}
        for path in sorted((self.root / "docs" / "images").glob("*")):
            file = str(path.relative_to(self.root))
            if file not in pictures:
                yield f"{file}: no entry in docs/manifest.toml makes it"
        for path in [self.root / "README.md", *sorted((self.root / "docs").glob("*.md"))]:
            file, text = str(path.relative_to(self.root)), path.read_text()
            found = MARKER.findall(text)
            if len(found) != text.count("<!-- figure") or len(found) != text.count("<!-- /figure"):
                yield f"{file}: a marker of a figure without its other half"
            for figure, body in found:
                if (figure, file) not in figures:
                    yield f"{file}: no entry in docs/manifest.toml makes {figure}"
                if "\n" not in body and re.search(rf"^\s*<!-- figure {figure} -->", text, re.MULTILINE):
                    yield f"{file}: {figure} begins a line, which makes the line raw HTML"

    def save(self, entry, inputs):
        self.lock[entry.name] = inputs, entry.outputs()
        known = [name for name in sorted(self.lock) if name in self.entries]
        lines = ["{} inputs {} outputs {}\n".format(name, *self.lock[name]) for name in known]
        self.path.write_text("".join(lines))

    def check(self, names, edits_only=False):
        """Name -> error of each wrong entry; prints progress."""
        wrong = {}
        for name in names:
            started = time.monotonic()
            try:
                self.entries[name].check(self.lock, edits_only)
                verdict = "current"
            except Stale as stale:
                wrong[name] = str(stale)
                verdict = f"STALE: {stale}"
            print(f"{time.monotonic() - started:6.1f} s  {name}: {verdict}", flush=True)
        return wrong


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help="entries of docs/manifest.toml")
    parser.add_argument("--all", action="store_true", help="regenerate all but what was measured on a date")
    parser.add_argument("--check", action="store_true", help="exit 1 if anything is stale")
    parser.add_argument("--accept", action="store_true", help="keep the text of these entries")
    parser.add_argument("--edits", action="store_true", help="with --check: no runs, edits by hand only")
    parser.add_argument("--root", type=pathlib.Path, default=ROOT, help="folder of README.md and docs/")
    arguments = parser.parse_args()
    manifest = Manifest(arguments.root)
    unknown = [name for name in arguments.names if name not in manifest.entries]
    if unknown:
        parser.error(f"{unknown[0]}: no such entry; the entries are: {', '.join(manifest.entries)}")
    names = arguments.names or list(manifest.entries)

    if arguments.check:
        stray = list(manifest.stray())
        wrong = manifest.check(names, arguments.edits)
        print(*stray, sep="\n", end="\n" if stray else "")
        if wrong:
            print(f"type: tools/scripts/regenerate.py {' '.join(wrong)}")
        sys.exit(1 if wrong or stray else 0)
    if not arguments.names and not arguments.all:
        names = list(manifest.check(names))
    failed = []
    for name in names:
        entry = manifest.entries[name]
        if arguments.accept and not (entry.measured or entry.checked):
            parser.error(f"--accept {name}: its command can be run: tools/scripts/regenerate.py {name}")
        if not arguments.accept and (entry.by_hand() or arguments.all and entry.measured):
            print(f"          {name}: left alone; measure again with {entry.command}, or --accept {name}")
            continue
        started = time.monotonic()
        print(f"          {name} …", flush=True)
        try:
            locked = not entry.quick or entry.tolerance
            # The probe runs first, because it fails early.
            inputs = entry.inputs() if locked else None
            if not arguments.accept:
                entry.regenerate()
            if locked:
                manifest.save(entry, inputs)
            verdict = "accepted" if arguments.accept else "regenerated"
        except Stale as error:
            failed.append(name)
            verdict = f"FAILED: {error}"
        print(f"{time.monotonic() - started:6.1f} s  {name}: {verdict}", flush=True)
    sys.exit(f"regenerate.py: failed: {' '.join(failed)}" if failed else 0)


if __name__ == "__main__":
    main()
