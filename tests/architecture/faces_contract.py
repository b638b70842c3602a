"""A contract for import-linter: what a room keeps to itself (`_name.py`) is imported from within that room only."""

from typing import Any

import grimp
from importlinter import Contract, ContractCheck, output


class FacesContract(Contract):
    """No module imports a module whose name begins with an underscore from another folder."""

    type_name = "faces"

    def check(self, graph: grimp.ImportGraph, verbose: bool) -> ContractCheck:
        """Find the imports that reach past a face."""
        past: list[tuple[str, str, Any]] = []
        for private in sorted(m for m in graph.modules if m.rpartition(".")[2].startswith("_")):
            room = private.rpartition(".")[0]
            for importer in sorted(graph.find_modules_that_directly_import(private)):
                if importer != room and importer.rpartition(".")[0] != room:
                    details = graph.get_import_details(importer=importer, imported=private)
                    past.append((importer, private, details[0]["line_number"]))
        return ContractCheck(kept=not past, metadata={"past": past})

    def render_broken_contract(self, check: ContractCheck) -> None:
        """Say where, and what to import in its place."""
        for importer, private, line in check.metadata["past"]:
            room = private.rpartition(".")[0]
            output.print_error(f"{importer}:{line} imports {private}; import what it needs from {room}, or export it")
