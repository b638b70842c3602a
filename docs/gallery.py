"""Make the pictures of docs/gallery.md by running what stands there: ``make gallery``, some ten minutes."""

import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

PAGE = Path(__file__).parent / "gallery.md"
PICTURES = Path(__file__).parent / "images" / "gallery"
BLOCK = re.compile(r"^```(sh|toml|python)\n(.*?)^```", flags=re.MULTILINE | re.DOTALL)
PICTURE = re.compile(r"^!\[[^\]]+\]\(images/gallery/([\w-]+\.(?:svg|png))\)", flags=re.MULTILINE)


def follow(text: str, folder: Path) -> None:
    """Write the files and run the commands and Python of a page in a folder, in its order; Python keeps its names."""
    names: dict[str, object] = {}
    for kind, block in BLOCK.findall(text):
        if kind == "toml":
            (folder / block.splitlines()[0].removeprefix("# ")).write_text(block, encoding="utf-8")
        elif kind == "sh":
            environment = {"PATH": f"{Path(sys.executable).parent}:/usr/bin:/bin", "HOME": str(Path.home())}
            subprocess.run(["bash", "-euc", block], cwd=folder, check=True, env=environment)
        else:
            exec(compile(block, PAGE.name, "exec"), names)


def main() -> None:
    """Run the page and keep its pictures."""
    import contextlib

    text = PAGE.read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as temporary, contextlib.chdir(temporary):
        follow(text, Path(temporary))
        PICTURES.mkdir(exist_ok=True)
        for name in PICTURE.findall(text):
            shutil.copy(Path(temporary) / name, PICTURES / name)


if __name__ == "__main__":
    main()
