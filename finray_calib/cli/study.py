"""``finray study``: ready-made studies; each writes a record and a figure into a folder."""

import argparse
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

from finray_calib.cli.options import add_out, add_seed, command_line, input_digests, require_new, say
from finray_calib.cli.study_illumination import add_illumination_studies
from finray_calib.cli.study_normal_map import add_normal_map_study
from finray_calib.cli.study_pixel_scale import add_pixel_scale_study
from finray_calib.cli.study_stiffness import add_stiffness_study

if TYPE_CHECKING:
    from data_schemas.paper_paints import PaperStatement
    from finray_calib.cli.own_process import LongWork

HELP = "run a ready-made study of the paper: paints, fluorescent rendering, two lights, light angle, stiffness, normals"
WIDTH = 110
PAPER_PAINTS_HELP = "the paper's statements on its red and green paint beside measured stand-ins"
PAPER_PAINTS_DESCRIPTION = """\
Compare what the paper says about its two fluorescent paints (Stokes shifts of 100 and 50 nm, 2 to 5 %
reradiation, its four-parameter curve, the ColorChecker match) with measured materials of the same
colours, and say which statements hold and why the others do not. The materials are also seen through
the paper's eight filters, with errors of 1 % and 0.3 %, and fitted twice: by the paper's curve alone,
and by the model of 'finray fit' with its 95 % band. Writes a record and a figure."""
PAPER_PAINTS_EPILOG = """\
The materials are re-radiation (Donaldson) matrices as CSV: first column emission_nm, then one column
for each excitation wavelength in nm, values as radiance factor in the emission band; lines that start
with # are comments. Needed are excitations from 380 to 450 nm and emission from 470 to 780 nm. Open
ones (BSD-3-Clause): the Post-it notes of github.com/afichet/spectral-exr, the inks and textiles of
github.com/afichet/fluorescence-rgb.

example:
  finray study paper-paints --red ink.csv --green textile.csv --green paper.csv --out study"""


def add_parser(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb and its studies."""
    parser = verbs.add_parser("study", help=HELP, description=HELP)
    parser.set_defaults(long_work=_long_work)
    studies = parser.add_subparsers(dest="study", metavar="STUDY", title="studies", required=True)
    paints = studies.add_parser(
        "paper-paints",
        help=PAPER_PAINTS_HELP,
        description=PAPER_PAINTS_DESCRIPTION,
        epilog=PAPER_PAINTS_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    for colour in ("red", "green"):
        paints.add_argument(
            f"--{colour}", type=Path, action="append", default=[], metavar="CSV",
            help=f"measured matrix that stands for the {colour} paint; may be given several times",
        )  # fmt: skip
    add_out(paints, "paper-paints, a folder")
    add_seed(paints)
    paints.set_defaults(run=run_paper_paints)
    add_illumination_studies(studies)
    add_stiffness_study(studies)
    add_normal_map_study(studies)
    add_pixel_scale_study(studies)


def _long_work(arguments: argparse.Namespace) -> "LongWork":
    """Return which study is about to be made."""
    from finray_calib.cli.own_process import LongWork

    kept = "Nothing is stored before its end: the same command begins again"
    return LongWork(f"the study {arguments.study}", kept, arguments.out)


def run_paper_paints(arguments: argparse.Namespace) -> None:
    """Compare the paper's statements with measured materials, and report."""
    import numpy as np

    from data_schemas.curve_files import read_donaldson_matrix
    from data_schemas.product_set import ProductSet
    from data_schemas.provenance import provenance
    from data_schemas.storage import write_record
    from finray_calib.reports.paper_paints_figure import paper_paints_png
    from sim.experiments.paper_paints import reproduce_paper_paints

    out = require_new(arguments.out or Path("paper-paints"))
    red, green = ([read_donaldson_matrix(path) for path in paths] for paths in (arguments.red, arguments.green))
    study = reproduce_paper_paints(red, green, np.random.default_rng(arguments.seed))
    inputs = input_digests([*arguments.red, *arguments.green])
    picture = paper_paints_png(study)
    with ProductSet(out) as products:
        products.add(out / "paper-paints.png", picture)
        write_record(study, out / "paper-paints.json", provenance(command_line(), inputs, arguments.seed), products)
    say(f"{out}: paper-paints.json, paper-paints.png")
    for statement in study.statements:
        say(_in_words(statement))
    say("\n" + textwrap.fill(study.caveat, WIDTH))


def _in_words(statement: "PaperStatement") -> str:
    """Return a statement as a block of lines: verdict and subject, then paper, measurement and reason."""
    widest = max(map(len, statement.ours), default=0)
    return "\n".join(
        (
            f"\n{statement.verdict.upper()}: {statement.subject}",
            _entry("paper", statement.paper),
            _entry("here", statement.measure),
            *(_entry("", f"{name:{widest}s}  {text}", widest + 2) for name, text in statement.ours.items()),
            _entry("why", statement.why),
        )
    )


def _entry(title: str, text: str, hanging: int = 0) -> str:
    """Return a titled paragraph; further lines start below the text, `hanging` characters further in."""
    indent = " " * 8
    return textwrap.fill(text, WIDTH, initial_indent=f"  {title:6s}", subsequent_indent=indent + " " * hanging)
