"""Draw which room of the code imports which, from the code: ``make drawing``.

The drawing goes into docs/explanation/architecture.md, the table with every arrow into docs/reference/rooms.md.

A room is a folder with an ``__init__.py``. An arrow means "imports"; one that follows from others is left out, so that
the drawing can be read. Imports for type checkers only do not count, those inside functions do.
"""

import graphlib
import sys
from collections.abc import Mapping, Set
from pathlib import Path

import grimp

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "explanation" / "architecture.md"
TABLE_PAGE = ROOT / "docs" / "reference" / "rooms.md"
BEGIN, END = "<!-- drawn by make drawing -->", "<!-- end of what is drawn -->"
PACKAGES = ("data_schemas", "rigs", "finray_calib", "sim")

Rooms = dict[str, set[str]]


def imports_between_rooms() -> Rooms:
    """Return room -> the other rooms that its files import, over all packages."""
    graph = grimp.build_graph(*PACKAGES, exclude_type_checking_imports=True, cache_dir=None)
    rooms = {m for m in graph.modules if (ROOT / m.replace(".", "/") / "__init__.py").exists()}
    found: Rooms = {room: set() for room in rooms}
    for module in graph.modules:
        for target in graph.find_modules_directly_imported_by(module):
            found[_room(module, rooms)].add(_room(target, rooms))
    return {room: targets - {room} for room, targets in found.items()}


def _room(module: str, rooms: Set[str]) -> str:
    return module if module in rooms else module.rpartition(".")[0]


def overview(rooms: Mapping[str, set[str]]) -> Rooms:
    """Return the rooms of finray_calib beside the other packages, each taken as one."""
    bare = {room for room in rooms if room == "finray_calib" and not rooms[room]}

    def one(room: str) -> str:
        parts = room.split(".")
        return ".".join(parts[:2]) if parts[0] == "finray_calib" else parts[0]

    drawn: Rooms = {}
    for room, targets in rooms.items():
        if room not in bare:
            drawn.setdefault(one(room), set()).update(one(t) for t in targets if one(t) != one(room))
    return {room: targets & drawn.keys() for room, targets in drawn.items()}


def inside(rooms: Mapping[str, set[str]], package: str) -> Rooms:
    """Return the rooms within a package; what lies in its own folder, its face, is not drawn."""
    within = {room for room in rooms if room.startswith(f"{package}.")}
    return {room: rooms[room] & within for room in within}


def without_shortcuts(rooms: Mapping[str, set[str]]) -> Rooms:
    """Leave out each arrow that a chain of other arrows says, too.

    Raises
    ------
    graphlib.CycleError
        Rooms import each other in a circle.
    """
    reach: Rooms = {}
    for room in graphlib.TopologicalSorter(rooms).static_order():
        reach[room] = set(rooms[room]).union(*(reach[target] for target in rooms[room]))
    return {
        room: {target for target in targets if not any(target in reach[other] for other in targets - {target})}
        for room, targets in rooms.items()
    }


def mermaid(rooms: Mapping[str, set[str]]) -> str:
    """Return the drawing in Mermaid's language, which GitHub and GitLab draw."""
    kept = without_shortcuts(rooms)
    lines = ["```mermaid", "flowchart TD"]
    lines += [f'    {_node(room)}["{room.removeprefix("finray_calib.")}"]' for room in sorted(kept)]
    lines += [f"    {_node(room)} --> {_node(target)}" for room in sorted(kept) for target in sorted(kept[room])]
    return "\n".join([*lines, "```"])


def _node(room: str) -> str:
    return room.replace(".", "_")


def table(rooms: Mapping[str, set[str]]) -> str:
    """Return room, its first sentence and the rooms that it imports, as a table; all import ``data_schemas``."""
    lines = ["| package | what it is for | imports, besides `data_schemas` |", "|---|---|---|"]
    for room in sorted(rooms):
        first = (ROOT / room.replace(".", "/") / "__init__.py").read_text(encoding="utf-8").partition("\n")[0]
        words = first.lstrip("r").strip('"').replace("|", "\\|").replace(":mod:", "")
        imported = ", ".join(sorted(rooms[room] - {"data_schemas"}))
        lines.append(f"| `{room}` | {words} | {imported} |")
    return "\n".join(lines)


def table_page(rooms: Mapping[str, set[str]]) -> str:
    """Return the page with the table of all rooms."""
    head = (
        "`make drawing` makes this page from the code. It lists every import, including those that the drawing of the "
        "architecture leaves out. A test fails when the page is out of date."
    )
    drawn = "[How the code is built](../explanation/architecture.md#the-drawing) has the drawing."
    return "\n\n".join(["# Packages of the code and what they import", f"{head} {drawn}", table(rooms)]) + "\n"


def drawn_part(rooms: Mapping[str, set[str]]) -> str:
    """Return what stands between the two marks of the page."""
    parts = [
        mermaid(overview(rooms)),
        "Inside `rigs`:",
        mermaid(inside(rooms, "rigs")),
        "Inside `sim`:",
        mermaid(inside(rooms, "sim")),
    ]
    return "\n\n".join(parts)


def redrawn(page: str, rooms: Mapping[str, set[str]]) -> str:
    """Return the text of the page with its drawing made anew."""
    before, begin, rest = page.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise ValueError(f"{PAGE}: needs the two lines {BEGIN} and {END}; what lies between them is drawn")
    return f"{before}{BEGIN}\n\n{drawn_part(rooms)}\n\n{END}{after}"


if __name__ == "__main__":
    found = imports_between_rooms()
    PAGE.write_text(redrawn(PAGE.read_text(encoding="utf-8"), found), encoding="utf-8")
    TABLE_PAGE.write_text(table_page(found), encoding="utf-8")
    sys.stdout.write(f"{PAGE}: drawn\n{TABLE_PAGE}: written\n")
