"""Make a release: ``python requirements/release.py 0.1.0``; nothing is written without ``--write``.

The version stands in pyproject.toml, CITATION.cff and requirements/recipe.yaml, which are set together. What the
changelog holds as unreleased becomes the section of the version. With ``--write`` this is committed and tagged; the tag
is pushed by a person, and `python -m build` makes the files.
"""

import argparse
import datetime
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
UNRELEASED = "## Unreleased"
VERSION = r"\d+\.\d+\.\d+"
PLACES = {
    "pyproject.toml": rf'(?m)^version = "({VERSION})"',
    "CITATION.cff": rf"(?m)^version: ({VERSION})$",
    "requirements/recipe.yaml": rf'(?m)^  version: "({VERSION})"',
}
"""File -> where the version stands in it."""


class ReleaseError(Exception):
    """The release cannot be made."""


def git(root: Path, *words: str) -> str:
    """Run git and return what it prints."""
    return subprocess.run(["git", *words], cwd=root, capture_output=True, text=True, check=True).stdout


def as_numbers(version: str) -> tuple[int, ...]:
    """Return a version as numbers that can be compared."""
    return tuple(int(part) for part in version.split("."))


def changed(root: Path, version: str, day: datetime.date) -> dict[str, str]:
    """Return file -> its text in the release.

    Raises
    ------
    ReleaseError
        The version is no later one, a file lacks its place, or nothing is unreleased.
    """
    texts = {}
    for name, pattern in PLACES.items():
        text = (root / name).read_text(encoding="utf-8")
        found = re.search(pattern, text)
        if found is None:
            raise ReleaseError(f"{name}: holds no version where it is expected")
        released = f"v{found[1]}" in git(root, "tag").split()
        if as_numbers(version) < as_numbers(found[1]) or (released and version == found[1]):
            raise ReleaseError(f"{name}: is at {found[1]}; give a later version than {version}")
        texts[name] = text[: found.start(1)] + version + text[found.end(1) :]
    citation = re.sub(r"(?m)^date-released: .*\n", "", texts["CITATION.cff"])
    texts["CITATION.cff"] = re.sub(r"(?m)^(version: .*)$", rf"\1\ndate-released: {day.isoformat()}", citation)
    changelog = (root / "CHANGELOG.md").read_text(encoding="utf-8")
    below = changelog.partition(f"{UNRELEASED}\n")[2]
    if not re.split(r"(?m)^## ", below)[0].strip():
        raise ReleaseError(f"CHANGELOG.md: nothing stands below '{UNRELEASED}'; write what changes in the numbers")
    texts["CHANGELOG.md"] = changelog.replace(UNRELEASED, f"{UNRELEASED}\n\n## {version} ({day.isoformat()})", 1)
    return texts


def require_ready(root: Path, version: str) -> None:
    """Refuse what is no version, a tag that is there, and changes that are not committed.

    Raises
    ------
    ReleaseError
        One of these.
    """
    if not re.fullmatch(VERSION, version):
        raise ReleaseError(f"{version!r}: give three numbers with points between them, such as 0.1.0")
    if f"v{version}" in git(root, "tag").split():
        raise ReleaseError(f"v{version}: this tag is there already; give a later version")
    dirty = git(root, "status", "--porcelain", "--untracked-files=no").split("\n")[0]
    if dirty:
        raise ReleaseError(f"{dirty.strip()}: is not committed; commit it first")


def release(root: Path, version: str, day: datetime.date, write: bool) -> list[str]:
    """Make a release, or say what it would be; return the lines to print."""
    require_ready(root, version)
    texts = changed(root, version, day)
    lines = []
    for name, text in texts.items():
        before = (root / name).read_text(encoding="utf-8").splitlines()
        new = [line for line in text.splitlines() if line not in before]
        lines += [f"{name}: {line}" for line in new] or [f"{name}: unchanged"]
    if not write:
        return [*lines, f"nothing was written; add --write to commit this and to tag it v{version}"]
    for name, text in texts.items():
        (root / name).write_text(text, encoding="utf-8")
    git(root, "commit", "--quiet", "--all", "--message", f"Release {version}")
    git(root, "tag", "--annotate", f"v{version}", "--message", f"finray-calib {version}")
    return [*lines, f"committed and tagged v{version}; push it with: git push --follow-tags"]


def main(words: list[str] | None = None) -> int:
    """Run as a program."""
    parser = argparse.ArgumentParser(description="Set the version everywhere, close the changelog, commit and tag.")
    parser.add_argument("version", help="such as 0.1.0")
    parser.add_argument("--write", action="store_true", help="write, commit and tag; without it only say what would be")
    arguments = parser.parse_args(words)
    try:
        lines = release(ROOT, arguments.version, datetime.datetime.now(datetime.UTC).date(), arguments.write)
    except ReleaseError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    sys.stdout.write("\n".join(lines) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
