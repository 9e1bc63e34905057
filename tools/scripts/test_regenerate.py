#!/usr/bin/env python3
"""Tests of regenerate.py: stale entries are found. The program is not run."""

import contextlib
import io
import pathlib
import re
import shutil
import tempfile
import unittest

from regenerate import MARKER, ROOT, Manifest

MANIFEST = """
[slow]
command = "cat $FROM/full > $OUT/result.json; cp $FROM/full $OUT/a.png"
probe = "cat $FROM/short > $OUT/result.json"
pictures = { "a.png" = "docs/images/a.png" }
[slow.text.error]
in = ["README.md"]
is = "{out['result'].e:.1f} cm"

[quick]
command = "cat $FROM/short"
quick = true
[quick.text.rows]
in = ["docs/page.md"]
is = '''
| e |
|---|
| {stdout.strip()} |
'''
"""


class Repository(unittest.TestCase):
    """Repository of two pages and a picture, with `cat` as program."""

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.root = pathlib.Path(folder.name)
        (self.root / "docs" / "images").mkdir(parents=True)
        self.put("docs/manifest.toml", MANIFEST.replace("$FROM", str(self.root)))
        self.put("README.md", "It is <!-- figure error -->old<!-- /figure --> off.\n")
        self.put("docs/page.md", "<!-- figure rows -->\n<!-- /figure -->\n")
        self.put("full", '{"e": 2.04}')
        self.put("short", '{"e": 1.5}')
        manifest = Manifest(self.root)
        for entry in manifest.entries.values():
            entry.regenerate()
        manifest.save(manifest.entries["slow"], manifest.entries["slow"].inputs())

    def put(self, file, text):
        (self.root / file).write_text(text)

    def edit(self, file, old, new):
        text = (self.root / file).read_text()
        self.assertIn(old, text)
        self.put(file, text.replace(old, new))

    def stale(self):
        manifest = Manifest(self.root)
        with contextlib.redirect_stdout(io.StringIO()):
            return manifest.check(manifest.entries), list(manifest.stray())

    def test_fresh_state_is_current(self):
        self.assertEqual((self.root / "README.md").read_text(), "It is <!-- figure error -->2.0 cm<!-- /figure --> off.\n")
        self.assertIn('\n| {"e": 1.5} |\n', (self.root / "docs/page.md").read_text())
        self.assertEqual(self.stale(), ({}, []))

    def test_number_edited_by_hand_is_stale(self):
        self.edit("README.md", "2.0", "1.9")
        self.assertIn("edited by hand", self.stale()[0]["slow"])

    def test_quick_table_edited_by_hand_shows_difference(self):
        self.edit("docs/page.md", "1.5", "1.4")
        self.assertIn('-| {"e": 1.4} |\n+| {"e": 1.5} |', self.stale()[0]["quick"])

    def test_picture_edited_by_hand_is_stale(self):
        self.put("docs/images/a.png", "another")
        self.assertIn("edited by hand", self.stale()[0]["slow"])

    def test_other_result_of_the_probe_is_stale(self):
        self.put("short", '{"e": 1.5000001}')
        self.assertIn("another result", self.stale()[0]["slow"])

    def test_edited_template_is_stale(self):
        self.edit("docs/manifest.toml", ":.1f", ":.2f")
        self.assertIn("edited entry", self.stale()[0]["slow"])

    def test_template_without_its_result_is_stale(self):
        self.edit("docs/manifest.toml", "stdout.strip()", "out['gone']")
        self.assertIn("does not fit", self.stale()[0]["quick"])

    def test_failing_command_is_stale(self):
        self.edit("docs/manifest.toml", f'"cat {self.root}/short"', '"exit 3"')
        self.assertIn("exit code 3", self.stale()[0]["quick"])

    def test_lost_marker_is_stale(self):
        self.put("README.md", "It is 2.0 cm off.\n")
        self.assertIn("no <!-- figure error -->", self.stale()[0]["slow"])

    def test_figure_or_picture_without_entry_is_named(self):
        self.put("docs/images/b.png", "")
        self.put("docs/other.md", "a <!-- figure gone -->1<!-- /figure --> <!-- figure open -->\n")
        named = "\n".join(self.stale()[1])
        for part in ("b.png", "gone", "without its other half"):
            self.assertIn(part, named)


class Readme(unittest.TestCase):
    def edited(self, root, text):
        (root / "README.md").write_text(text)
        manifest = Manifest(root)
        with contextlib.redirect_stdout(io.StringIO()):
            return manifest.check(manifest.entries, edits_only=True)

    def test_each_digit_of_readme_is_held(self):
        with tempfile.TemporaryDirectory() as folder:
            root = pathlib.Path(folder)
            shutil.copytree(ROOT / "docs", root / "docs")
            text = (ROOT / "README.md").read_text()
            self.assertEqual(self.edited(root, text), {})
            digits = [match.start(2) + digit.start()
                      for match in MARKER.finditer(text) for digit in re.finditer(r"\d", match[2])]
            self.assertGreater(len(digits), 20)
            for at in digits:
                digit = "5" if text[at] != "5" else "6"
                wrong = self.edited(root, text[:at] + digit + text[at + 1:])
                self.assertTrue(wrong, text[at - 20:at + 20])


if __name__ == "__main__":
    unittest.main()
