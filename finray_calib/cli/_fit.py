"""``finray fit``: the emission spectrum of a paint with its uncertainty, of a region or pixel by pixel.

``finray simulate fit`` fits the numbers of a sensor to captures of it, ``finray fit-material`` moduli to force curves.
"""

import argparse
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, cast

from finray_calib.cli._output import (
    Progress,
    give,
    is_for_a_program,
    progress_bar,
    say,
    suggest_command,
    suggest_file,
    wrote,
)
from finray_calib.cli._run import (
    LongWork,
    add_out,
    add_paint,
    add_paints_as_given,
    add_seed,
    command_line,
    file_name,
    input_digests,
    naming,
    paint_files,
    require_new,
    with_files_found_from,
    working_engine,
)

if TYPE_CHECKING:
    from data_schemas import (
        BandSignals,
        Estimate,
        FittedNumber,
        MaterialFit,
        PaintCalibration,
        PaintMap,
        PaintWithoutEmission,
        SensorFit,
        SessionScatter,
    )
    from finray_calib.fit import BudgetRow
    from finray_calib.force import ForceModel, MeasuredForce
    from sim.mechanics import Plates


HELP = "fit the emission spectrum of a paint, with uncertainty"
DESCRIPTION = """\
Fit the emission spectrum of a paint to band signals. The spectrum rests on a prior learned from measured spectra, which
averages over shapes. For comparison the command also fits four families of curves, each with a Gaussian process that
describes how a real paint departs from its family, and the paper's skew-Cauchy curve alone; --family reports one of
the families instead. For a sample without emission beyond reflected laser, leak and stray light, the record holds an
upper limit of its yield in place of a spectrum. Writes posterior draws, the spectrum with its 95 % bands (pointwise
and of the whole curve), how much of each number comes from the prior, how well each filter is explained, and whether
the draws can be trusted."""
FAMILY_NAMES = ("auto", "log_normal_wavenumber", "zheng2014", "skew_t", "gaussian_mixture")


def add_fit(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser("fit", help=HELP, description=DESCRIPTION)
    parser.add_argument(
        "bands",
        type=Path,
        nargs="+",
        metavar="BANDS",
        help="record written by 'finray radiometry' (its pixel signals with --map); several records must be repeats "
        "of one paint on one rig, and give one calibration",
    )
    parser.add_argument(
        "--family",
        choices=FAMILY_NAMES,
        default="auto",
        metavar="FAMILY",
        help=f"report this family of curves: {', '.join(FAMILY_NAMES[1:])} (default: the prior learned from measured "
        "spectra)",
    )
    parser.add_argument(
        "--no-discrepancy", action="store_true", help="assume that the paint follows its family exactly"
    )
    parser.add_argument("--check", action="store_true", help="sample again with emcee, as an independent check")
    parser.add_argument(
        "--other-light",
        type=Path,
        action="append",
        default=[],
        metavar="BANDS",
        help="band signals of the same paint under another excitation light, to constrain the absorption (repeatable)",
    )
    parser.add_argument(
        "--room-light",
        type=Path,
        metavar="SESSION",
        help="session whose room-light frame gives the reflectance, as that of the ColorChecker patch closest to the "
        "paint (the paper's way, 30 %% uncertain), instead of the reflectance measured under the lamp",
    )
    parser.add_argument("--report", type=Path, metavar="PAGE", help="also write a page (HTML) that explains the fit")
    parser.add_argument(
        "--map", action="store_true", help="fit every pixel; BANDS is then the record of pixel signals of the session"
    )
    parser.add_argument("--paint", type=Path, metavar="PAINT", help="fit of the region (needed with --map)")
    add_out(parser, "PAINT.paint.json, with --map PAINT.map.json")
    add_seed(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Fit and report."""
    _refuse_ignored(arguments)
    if arguments.map:
        run_map(arguments)
        return
    from data_schemas import BandSignals, FitError, PaintWithoutEmission, provenance
    from data_schemas.storage import ProductSet, read_record, write_record
    from finray_calib import fit_paint

    sessions = [read_record(path, BandSignals) for path in arguments.bands]
    bands, scatter = _together(sessions, arguments.bands)
    others = [read_record(path, BandSignals) for path in arguments.other_light]
    out = require_new(arguments.out or Path(f"{file_name(bands.paint_name)}.paint.json"), ".json")
    if arguments.report is not None:
        require_new(arguments.report, ".html")
    files = [*arguments.bands, *arguments.other_light]
    with progress_bar("fit"), naming(FitError, *files):
        paint = fit_paint(
            sessions, other_lights=others, family=arguments.family, discrepancy=not arguments.no_discrepancy,
            check=arguments.check, room_light=arguments.room_light, seed=arguments.seed,
        )  # fmt: skip
        budget = _budget(paint, bands, arguments) if arguments.report is not None or is_for_a_program() else ()
    if arguments.room_light is not None:
        from rigs.capture import SESSION_NAME

        files.append(arguments.room_light / SESSION_NAME)
    with ProductSet(out) as products:
        if arguments.report is not None:
            products.add(arguments.report, _page(paint, bands, input_digests(files), budget).encode())
        write_record(paint, out, provenance(command_line(), input_digests(files), arguments.seed), products)
    if isinstance(paint, PaintWithoutEmission):
        wrote(out, f"NO EMISSION found in '{paint.paint_name}', so there is no spectrum")
        give(paint_name=paint.paint_name, emission_found=False, energy_yield_limit=paint.detection.yield_limit)
        say(f"  {paint.detection.statement}")
        say(
            "  check that this is the fluorescent sample and that the laser was on; --report PAGE shows its "
            "signals beside those of a sample without emission"
        )
    else:
        _say_result(paint, out, budget)
        _say_scatter(scatter, arguments.bands)
    if arguments.report is not None:
        wrote(arguments.report, "the fit explained; open it in a browser")
        suggest_file(arguments.report)


def _together(sessions: "Sequence[BandSignals]", files: Sequence[Path]) -> "tuple[BandSignals, SessionScatter | None]":
    """Return the band signals of one session, or what several share and how they differ."""
    if len(sessions) == 1:
        return sessions[0], None
    from data_schemas import FitError
    from finray_calib.fit import combine_sessions

    if len(set(files)) < len(files):
        raise FitError(f"{', '.join(map(str, files))}: one file is given twice; give each session once")
    with naming(FitError, *files):
        return combine_sessions(sessions)


def _say_scatter(scatter: "SessionScatter | None", files: Sequence[Path]) -> None:
    """Say how the sessions differ, if there are several."""
    if scatter is None:
        give(sessions=1)
        return
    give(
        sessions=len(files), session_levels_rel=scatter.session_levels_rel,
        between_sessions_level_rel=scatter.level_rel, between_sessions_filter_rel=scatter.filter_rel,
    )  # fmt: skip
    for name, value in (("level", scatter.level_rel), ("single filters", scatter.filter_rel)):
        say(
            f"  {f'between sessions, {name}':34s} {100 * value.estimate:.1f} % [{100 * value.low95:.1f} %, "
            f"{100 * value.high95:.1f} %] "
            "(standard deviation, 95 %)"
        )
    for file, level in zip(files, scatter.session_levels_rel, strict=True):
        say(f"    {file}: level {100 * level:+.1f} %")


def _budget(
    paint: "PaintCalibration | PaintWithoutEmission", bands: "BandSignals", arguments: argparse.Namespace
) -> "tuple[BudgetRow, ...]":
    """Return the budget of a fit under the learned prior; a sample without emission or a family has none."""
    from data_schemas import PaintWithoutEmission
    from finray_calib.fit import MEASURED_SPECTRA_TITLE, uncertainty_budget

    if isinstance(paint, PaintWithoutEmission) or paint.spectrum_from != MEASURED_SPECTRA_TITLE:
        return ()
    return uncertainty_budget(bands, paint, arguments.seed)


def _page(
    paint: "PaintCalibration | PaintWithoutEmission",
    bands: "BandSignals",
    digests: "dict[str, str]",
    budget: "tuple[BudgetRow, ...]",
) -> str:
    """Return the page of a fit, or of a sample without emission."""
    from data_schemas import PaintWithoutEmission

    if isinstance(paint, PaintWithoutEmission):
        from finray_calib.reports import no_emission_page

        return no_emission_page(paint, command_line(), digests)
    from finray_calib.reports import paint_report

    return paint_report(paint, bands, budget)


def _refuse_ignored(arguments: argparse.Namespace) -> None:
    """Refuse options that the fit asked for, of the region or of every pixel, would ignore."""
    from data_schemas import FitError

    of_the_region = {
        "--family": arguments.family != "auto",
        "--no-discrepancy": arguments.no_discrepancy,
        "--check": arguments.check,
        "--other-light": bool(arguments.other_light),
        "--room-light": arguments.room_light is not None,
        "--report": arguments.report is not None,
    }
    given = [name for name, is_given in of_the_region.items() if is_given]
    if arguments.map and given:
        raise FitError(
            f"{given[0]} cannot be combined with --map, because a map takes family and rig imperfections from "
            f"--paint; leave out {given[0]} or --map"
        )
    if arguments.paint is not None and not arguments.map:
        raise FitError(
            "--paint is supported only with --map, which starts from this fit of the region; add --map, "
            "or leave --paint out"
        )
    if arguments.map and len(arguments.bands) > 1:
        raise FitError(
            f"{arguments.bands[1]}: is a second record, but a map is made from only one session; give the pixel "
            "signals of one session, and its --paint"
        )


_LABELS = {
    "mode_nm": "mode",
    "fwhm_nm": "FWHM",
    "peak_per_nm": "peak",
    "energy_yield": "yield",
    "stokes_shift_nm": "Stokes shift",
}


def _say_result(paint: "PaintCalibration", out: Path, budget: "tuple[BudgetRow, ...]") -> None:
    """Tell the numbers and how far they can be trusted."""
    from finray_calib.fit import two_maxima
    from finray_calib.reports import pareto_text

    wrote(out, f"emission of '{paint.paint_name}' ({paint.spectrum_source})")
    _give_result(paint, budget)
    suggest_command("finray export", out, "--format csv")
    for name, label, unit in (
        ("mode_nm", "mode", " nm"),
        ("fwhm_nm", "FWHM", " nm"),
        ("energy_yield", "yield", ""),
        ("reflectance_at_laser", "reflectance at the laser", ""),
    ):
        value, digits = paint.parameters[name], 1 if unit else 3
        low, high = f"{value.low95:.{digits}f}", f"{value.high95:.{digits}f}"
        share = paint.prior_shares.get(name)
        belief = ", MOSTLY PRIOR: the bands hardly measure it" if share is not None and share.mostly_prior else ""
        say(f"  {label:26s} {value.estimate:.{digits}f} [{low}, {high}]{unit} (95 %{belief})")
    if (maxima := two_maxima(paint.wavelength_nm, paint.emission_draws_per_nm)) is not None:
        places = " and ".join(
            f"{place.estimate:.0f} [{place.low95:.0f}, {place.high95:.0f}] nm"
            for place in (maxima.first_nm, maxima.second_nm)
        )
        say(f"  {'two maxima':26s} {places} (95 %; probability {maxima.probability:.2f})")
    give(two_maxima=maxima)
    if paint.colour_match is not None:
        say(f"  {paint.colour_match.statement}")
    stokes = paint.reradiation.stokes_shift_nm
    found = "hardly measured" if len(paint.reradiation.measured_at_nm) > 1 else "not measured"
    belief = f", from the prior and the emission: absorption {found}" if paint.reradiation.prior_driven else ""
    say(f"  {'Stokes shift':26s} {stokes.estimate:.0f} [{stokes.low95:.0f}, {stokes.high95:.0f}] nm (95 %{belief})")
    if paint.prior_shares:
        shares = ", ".join(f"{_LABELS[name]} {100 * value.share:.0f} %" for name, value in paint.prior_shares.items())
        say(f"  variance after the measurement, as a share of the prior's: {shares}")
    beside = "" if paint.spectrum_from in ("", paint.family_title) else " of curves for comparison"
    say(f"  family{beside}: {paint.family_choice}")
    trust = "trusted" if paint.diagnostics.trusted else "NOT trusted"
    if paint.detection is not None:
        say(f"  {paint.detection.statement}")
    say(f"  draws: {paint.diagnostics.method}, {trust} (Pareto k {pareto_text(paint.diagnostics.pareto_k)})")
    for warning in paint.warnings:
        say(f"  warning: {warning}")


def _give_result(paint: "PaintCalibration", budget: "tuple[BudgetRow, ...]") -> None:
    """Give the numbers to a program."""
    names = ("mode_nm", "fwhm_nm", "peak_per_nm", "energy_yield", "reflectance_at_laser")
    give(
        paint_name=paint.paint_name,
        emission_found=True,
        **{name: paint.parameters[name] for name in names},
        stokes_shift_nm=paint.reradiation.stokes_shift_nm,
        prior_shares={name: value.share for name, value in paint.prior_shares.items()},
        family=paint.family,
        budget=budget,
        draws_trusted=paint.diagnostics.trusted,
        warnings=paint.warnings,
    )


def run_map(arguments: argparse.Namespace) -> None:
    """Fit every pixel, store the map with its figure, and report.

    Parameters
    ----------
    arguments
        ``bands``: path of the pixel signals; ``paint``: path of the region's fit, required; ``out``: path or none.

    Raises
    ------
    FitError
        No fit of the region was given, or pixels and fit do not go together.
    """
    from data_schemas import FitError, PaintCalibration, PixelSignals, provenance
    from data_schemas.storage import ProductSet, read_record, write_record
    from finray_calib.fit import map_paint
    from finray_calib.reports import paint_map_figure

    if arguments.paint is None:
        raise FitError(
            f"{arguments.bands[0]}: --map needs --paint, the fit of the region of the same session; run 'finray fit "
            "BANDS' first and add --paint PAINT.paint.json"
        )
    place: Path = arguments.bands[0]
    pixels = read_record(place, PixelSignals)
    paint = read_record(arguments.paint, PaintCalibration)
    out = require_new(arguments.out or Path(f"{file_name(pixels.paint_name)}.map.json"), ".json")
    picture = require_new(out.with_suffix(".svg"))
    with progress_bar("fit every pixel"), naming(FitError, place, arguments.paint):
        fitted = map_paint(pixels, paint)
    drawn = paint_map_figure(fitted).encode()
    digests = input_digests([place, arguments.paint])
    with ProductSet(out) as products:
        products.add(picture, drawn)
        write_record(fitted, out, provenance(command_line(), digests), products)
    wrote(out, f"'{fitted.paint_name}' in {fitted.fitted_pixels} pixels ({fitted.family})")
    wrote(picture, "figure of the map")
    suggest_file(picture)
    give(
        paint_name=fitted.paint_name, fitted_pixels=fitted.fitted_pixels, unusable_pixels=fitted.unusable_pixels,
        unconverged_pixels=fitted.unconverged_pixels, uniformity=fitted.uniformity,
    )  # fmt: skip
    _report_map(fitted)


def _report_map(fitted: "PaintMap") -> None:
    """Say how uniform the paint is and what could not be fitted."""
    from finray_calib.reports import spot_sentence, spots_note, spread_sentence

    for quantity in fitted.uniformity:
        say(f"  {spread_sentence(fitted, quantity)}")
    if fitted.unusable_pixels:
        say(f"  {fitted.unusable_pixels} pixels are masked or have fewer than four usable bands")
    if fitted.unconverged_pixels:
        say(f"  warning: {fitted.unconverged_pixels} pixels did not converge")
    if fitted.worst_spots:
        say(f"  spots whose yield differs most from the median. {spots_note(fitted)}")
    for spot in fitted.worst_spots:
        say(f"  {spot_sentence(spot)}")


SENSOR_HELP = "fit a sensor's lights, yields, gel, coat and picture to captures of it"
SENSOR_DESCRIPTION = """\
Fit the numbers of a sensor to a few captures of it: powers of its lights, yields of its paints, the camera's response,
one gain, shift, scale and blur of the picture, and the numbers of the design that --free names. DESIGN is a painted
finger (with --paint) or a classic sensor; its camera and its lights are those of the captures. The captures are presses
of one sensor at one exposure with linear values. Each number keeps the prior that the design states ([uncertainty_rel],
or the default for its [origin]); the command reports what the pictures do not determine. Depth and place of a press
are fitted where its capture states their uncertainty. Beside the record a design with the fitted values is written."""
_OUT_ENDING = ".sensor.json"


def add_sensor_fit(jobs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register ``finray simulate fit``."""
    parser = jobs.add_parser("fit", help=SENSOR_HELP, description=SENSOR_DESCRIPTION)
    parser.add_argument("design", type=Path, metavar="DESIGN", help="finger or classic sensor (TOML)")
    parser.add_argument(
        "--captures", type=Path, nargs="+", required=True, metavar="CAPTURE", help="tactile captures of one sensor"
    )
    parser.add_argument(
        "--free", nargs="+", default=[], metavar="NAME",
        help="further numbers of the design to fit, such as pad.thickness_mm or coating.roughness_alpha; each takes "
        "two renders of every press",
    )  # fmt: skip
    add_paint(parser)
    add_paints_as_given(parser)
    parser.add_argument(
        "--samples", type=int, default=128, metavar="N", help="paths per pixel, an even number (default: 128)"
    )
    parser.add_argument(
        "--shared-light", action="store_true", help="let pixels of a finger share light, see 'finray simulate render'"
    )
    parser.add_argument("--engine", choices=["auto", "llvm", "scalar"], default="auto", help="renderer (default: auto)")
    add_out(parser, f"NAME{_OUT_ENDING}, with NAME.fitted.toml beside it")
    add_seed(parser)
    parser.set_defaults(run=run_sensor_fit, long_work=_long_sensor_fit)


def _long_sensor_fit(arguments: argparse.Namespace) -> LongWork:
    """Return what is about to be done, and what of it is kept if its process dies."""
    nothing = "Nothing is stored before the end, so the same command starts from the beginning"
    return LongWork("the fit of the sensor", nothing, arguments.out)


def run_sensor_fit(arguments: argparse.Namespace) -> None:
    """Fit a sensor, store the record and the design with the fitted values, and report."""
    from data_schemas import FingerDesign, SimulateError, provenance
    from data_schemas.storage import ProductSet, write_record
    from finray_calib import fit_sensor
    from sim import design_toml, sensor_toml
    from sim.experiments import fitted_design

    out = require_new(arguments.out or Path(f"{file_name(arguments.design.stem)}{_OUT_ENDING}"), ".json")
    toml = require_new(out.with_name(f"{out.name.removesuffix('.json').removesuffix('.sensor')}.fitted.toml"))
    if arguments.samples < 2 or arguments.samples % 2:
        raise SimulateError(
            f"--samples {arguments.samples}: must be an even whole number of 2 or more, for example 128"
        )
    paints = paint_files(arguments, "a classic sensor")
    with progress_bar("fit the sensor") as progress, naming(SimulateError, arguments.design):
        fit = fit_sensor(
            arguments.design, arguments.captures, paints=paints, free=arguments.free,
            seed=arguments.seed, progress=progress, samples=arguments.samples, engine=working_engine(arguments.engine),
            shared_light=arguments.shared_light, paints_as_given=arguments.paints_as_given,
        )  # fmt: skip
    design = with_files_found_from(toml.parent, fitted_design(fit), arguments.design.parent)
    text = design_toml(design) if isinstance(design, FingerDesign) else sensor_toml(design)
    read = {} if fit.provenance is None else fit.provenance.input_sha256
    with ProductSet(out) as products:
        products.add(toml, text.encode())
        write_record(fit, out, provenance(command_line(), read, arguments.seed), products)
    wrote(out, f"'{fit.name}' fitted to {len(fit.captures)} captures, {fit.blocks} blocks of each picture")
    wrote(toml, "the design with the fitted values")
    _say_sensor_fit(fit)
    suggest_command("finray simulate render", toml)


def _say_sensor_fit(fit: "SensorFit") -> None:
    """Tell each number before and after, what is not told apart, and how good the model is."""
    give(
        name=fit.name, numbers=fit.numbers, brightness=fit.brightness, indistinguishable=fit.not_told_apart,
        not_told_apart=fit.not_told_apart,
        discrepancy_rel=fit.discrepancy_rel, independent_rel=fit.independent_rel, residual_rel=fit.residual_rel,
        emulator_rel=fit.emulator_rel, trusted=fit.trusted, notes=fit.notes,
    )  # fmt: skip
    say("  number: 95 % interval after the fit (before it), and its width as a share of the prior's:")
    for number in fit.numbers:
        say(f"    {_number_line(number)}")
    say("  brightness of each light and each fluorescence, relative to the design; the gain of the camera is included:")
    for layer in fit.brightness:
        say(f"    {layer.layer} ({layer.channel}): {layer.over_design_rel}")
    for combination in fit.not_told_apart:
        say(f"  not distinguishable: {combination}")
    say(
        f"  error of the model: smooth part {100 * fit.discrepancy_rel.estimate:.1f} %, independent in each "
        f"block {100 * fit.independent_rel.estimate:.1f} %, residual {100 * fit.residual_rel:.1f} % of the "
        "picture's mean"
    )
    say(f"  {'trusted' if fit.trusted else 'NOT trusted, see the notes'}")
    for note in fit.notes:
        say(f"  note: {note}")


def _number_line(number: "FittedNumber") -> str:
    """Return a number before and after in one line."""
    unit = "" if number.unit == "1" else f" {number.unit}"
    told = "" if number.verdict == "determined" else f": {number.verdict.upper()}"
    left = f"{100 * number.left_of_prior_rel:.0f} % of the prior{told}"
    return f"{number.name:32s} {number.posterior}{unit} ({number.prior}), {left}"


MATERIAL_HELP = "fit the moduli of a gel to force curves of a bench"
MATERIAL_DESCRIPTION = """\
Fit the moduli of a gel to measured force-displacement curves. The curves come from blocks of the gel between
plates, or from a finger. The model is the finite elements of 'finray simulate press' with their derivatives. The fit
gives C10 and K/mu of the gel, and for a finger also the moduli of its other parts, together with first touch, zero and
drift of the load cell and the noise. Each modulus is reported as measured, constrained in part, or not measured; where
it was not measured, its interval is the one assumed before.

  finray fit-material free.csv tight.csv --on 20x20x10:lubricated --on 20x20x10:confined
  finray fit-material finger.csv --on finger.toml"""
_BLOCK = re.compile(r"([0-9.]+)x([0-9.]+)x([0-9.]+):([a-z]+)", re.IGNORECASE)
_PLATES = ("lubricated", "bonded", "confined")
_MATERIAL_ENDING = ".material.json"
_DEEPER = 1.05  # than the curve: the first touch may lie above 0


def add_fit_material(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser("fit-material", help=MATERIAL_HELP, description=MATERIAL_DESCRIPTION)
    parser.add_argument(
        "curves", type=Path, nargs="+", metavar="CURVE",
        help="loading curve (CSV) with the columns displacement_mm (0 near first touch), force_n and, if known, "
             "force_uncertainty_n",
    )  # fmt: skip
    parser.add_argument(
        "--on", action="append", required=True, metavar="SPECIMEN",
        help="what the curve was measured on (give once for each curve): a block LENGTHxWIDTHxHEIGHT:PLATES in mm, "
             "where PLATES is lubricated (sides free), bonded (glued to both plates) or confined (walls around), or "
             "the design (TOML) of a finger that was pressed by its indenter",
    )  # fmt: skip
    add_out(parser, f"NAME{_MATERIAL_ENDING}, with a picture beside it")
    add_seed(parser)
    parser.set_defaults(run=run_fit_material, long_work=_long_material_fit)


def _long_material_fit(arguments: argparse.Namespace) -> LongWork:
    """Return what is about to be done, and what of it is kept if its process dies."""
    nothing = "Nothing is stored before the end, so the same command starts from the beginning"
    return LongWork("the fit of the material", nothing, arguments.out)


def run_fit_material(arguments: argparse.Namespace) -> None:
    """Fit, store record and picture, and report."""
    import numpy as np

    from data_schemas import CompareError, provenance
    from data_schemas.storage import ProductSet, write_record
    from finray_calib.exchange import read_force_csv
    from finray_calib.force import fit_material
    from finray_calib.reports import material_fit_png

    if len(arguments.on) != len(arguments.curves):
        raise CompareError(
            f"{len(arguments.curves)} curves but {len(arguments.on)} --on are given; give --on exactly once for each "
            "curve, in the same order"
        )
    name = file_name(arguments.curves[0].stem)
    out = require_new(arguments.out or Path(f"{name}{_MATERIAL_ENDING}"), ".json")
    picture = require_new(out.with_suffix(".png"))
    curves = [read_force_csv(path) for path in arguments.curves]
    with progress_bar("fit the material") as progress:
        models = [_specimen(given, curve, progress) for given, curve in zip(arguments.on, curves, strict=True)]
    with naming(CompareError, *arguments.curves):
        fit = fit_material(curves, models, np.random.default_rng(arguments.seed), name)
    read = [*arguments.curves, *(Path(given) for given in arguments.on if not _BLOCK.fullmatch(given))]
    with ProductSet(out) as products:
        products.add(picture, material_fit_png(fit))
        write_record(fit, out, provenance(command_line(), input_digests(read), arguments.seed), products)
    wrote(out, f"moduli by {len(curves)} force curve(s)")
    wrote(picture, "curves with their bands, and each modulus before and after")
    _say_material(fit)
    suggest_file(picture)


def _specimen(given: str, curve: "MeasuredForce", progress: Progress) -> "ForceModel":
    """Return the computed force of what a curve is of.

    Raises
    ------
    CompareError
        When it is neither a block nor a file.
    """
    from data_schemas import CompareError, SimulateError
    from finray_calib.spectra import machine_threads
    from sim import read_design
    from sim.experiments import block_force_model, finger_force_model
    from sim.mechanics import GelBlock

    push_mm = _DEEPER * float(curve.displacement_mm.max())
    found = _BLOCK.fullmatch(given)
    if found is None:
        if not Path(given).is_file():
            raise CompareError(
                f"--on {given}: is neither a file nor a block; give a design (TOML), or a block such as "
                f"20x20x10:lubricated (mm; {', '.join(_PLATES)})"
            )
        with naming(SimulateError, Path(given)):
            design = read_design(Path(given))
            model = finger_force_model(design, push_mm, machine_threads(), progress, Path(given).parent)
        return model
    sizes, plates = found.groups()[:3], found.group(4).lower()
    if plates not in _PLATES:
        raise CompareError(f"--on {given}: plates {plates!r} are not supported; give one of {', '.join(_PLATES)}")
    try:
        edges = [float(size) for size in sizes]
    except ValueError:
        raise CompareError(f"--on {given}: the edges must be numbers in mm, such as 20x20x10:{plates}") from None
    try:
        block = GelBlock(edges[0], edges[1], edges[2], cast("Plates", plates))
        return block_force_model(block, push_mm, machine_threads(), progress)
    except SimulateError as refused:
        raise SimulateError(f"--on {given}, {curve.name}: {refused}") from refused


def _say_material(fit: "MaterialFit") -> None:
    """Tell each modulus before and after, first touch and noise of each curve, and what goes into a design."""
    give(
        name=fit.name, moduli=fit.moduli, bulk_modulus_mpa=fit.bulk_modulus_mpa, trusted=fit.trusted,
        design_toml=fit.design_toml, notes=fit.notes,
    )  # fmt: skip
    say("  modulus: 95 % interval after the fit (before it), and its width as a share of the prior's:")
    for modulus in fit.moduli:
        unit = "" if modulus.unit == "1" else f" {modulus.unit}"
        told = modulus.verdict if modulus.verdict == "measured" else modulus.verdict.upper()
        left = f"{100 * modulus.left_of_prior_rel:.0f} % of the prior: {told}"
        say(f"    {modulus.field:34s} {_plain(modulus.posterior)}{unit} ({_plain(modulus.prior)}), {left}")
    say(f"    {'K of the gel':34s} {_plain(fit.bulk_modulus_mpa)} MPa")
    for curve in fit.curves:
        say(
            f"  {curve.measured}: first touch at {curve.first_touch_mm} mm, noise {curve.noise_n} N, residual "
            f"{curve.residual_rms_n:.3g} N"
        )
    for note in fit.notes:
        say(f"  note: {note}")
    if fit.design_toml:
        say("  to copy into the design file of a finger:")
        say("\n".join(f"    {line}" for line in fit.design_toml.splitlines()), fold=False)
    else:
        say("  no modulus of the gel was measured, so there is nothing to copy into a design")


def _plain(value: "Estimate") -> str:
    """Return an estimate whose interval may span decades, each number to three digits."""
    return f"{value.estimate:.3g} [{value.low95:.3g}, {value.high95:.3g}]"
