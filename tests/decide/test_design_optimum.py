"""A search over designs is judged: gains, front, real differences, and what could still be gained."""

import re
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from data_schemas import DesignObjective, DesignOptimum, DesignParameter, EvaluatedDesign, FingerDesign
from finray_calib.decide import DesignSearch, design_optimum, losses, screening_designs
from finray_calib.decide._design_emulator import DesignEmulator, fit_emulator

Floats = NDArray[np.float64]
ERROR = DesignObjective(name="error", unit="deg", meaning="made up", larger_is_better=False)
LIGHT = DesignObjective(name="light", unit="1", meaning="made up", larger_is_better=True)
PARAMETERS = tuple(
    DesignParameter(field=name, low=0.0, high=10.0, start=9.0) for name in ("light.angle_deg", "pad.thickness_mm")
)


def error_of(x: Floats) -> float:
    """Return an error that is least, 2 deg, at (0.3, 0.5)."""
    return float(2.0 * np.exp(2.0 * (x[0] - 0.3) ** 2 + (x[1] - 0.5) ** 2))


def light_of(x: Floats) -> float:
    """Return light that grows with the first input: a trade with the error beyond 0.3."""
    return float(np.exp(x[0]))


def search(
    objectives: tuple[DesignObjective, ...] = (ERROR, LIGHT),
    noise_rel: float = 0.005,
    chosen: tuple[float, float] = (0.3, 0.5),
) -> DesignSearch:
    """Return 40 designs of a made-up finger; the chosen one is near the best error, and one has failed."""
    rng = np.random.default_rng(3)
    places = np.concatenate([[[0.9, 0.9]], screening_designs(2, 38, 2), [chosen]])
    evaluated = []
    for k, x in enumerate(places):
        values = {"error": error_of(x), "light": light_of(x)}
        values = {name: value * np.exp(noise_rel * rng.standard_normal()) for name, value in values.items()}
        failure = "the panel is in the way" if k == 7 else ""
        evaluated.append(
            EvaluatedDesign(key=f"{k}", values={} if failure else values, failure=failure, processor_s=1.0,
                            design=FingerDesign())
        )  # fmt: skip
    return DesignSearch(
        objectives,
        PARAMETERS,
        places,
        tuple({p.field: float(10.0 * v) for p, v in zip(PARAMETERS, x, strict=True)} for x in places),
        ("start", *["screen"] * 20, *["search"] * 18, "chosen"),
        tuple(evaluated),
    )


@pytest.fixture(scope="module")
def optimum() -> DesignOptimum:
    return design_optimum(search(), None, seed=1)


def test_gains_are_those_of_the_made_up_finger(optimum: DesignOptimum) -> None:
    true = 1.0 - error_of(np.array([0.3, 0.5])) / error_of(np.array([0.9, 0.9]))
    gain = next(g for g in optimum.gains if (g.objective, g.against) == ("error", "start"))
    low, high = gain.expected_95_rel
    assert low < true < high
    assert high - low < 0.05
    assert gain.confirmed_rel is None
    # the start has more light: the gain is negative
    loss = next(g for g in optimum.gains if (g.objective, g.against) == ("light", "start"))
    assert loss.expected_95_rel[1] < 0.0
    assert loss.expected_95_rel[0] < np.exp(0.3 - 0.9) - 1.0 < loss.expected_95_rel[1]


def test_the_sentence_says_to_build_what_is_better_and_else_to_keep_the_start(optimum: DesignOptimum) -> None:
    assert optimum.sentence.startswith("Build the finger with light.angle_deg 3, pad.thickness_mm 5: error ")
    same = design_optimum(search((ERROR,), chosen=(0.9, 0.9)), None, seed=1)
    words = "Keep the starting design: the best design found (light.angle_deg 9, pad.thickness_mm 9) is not shown"
    assert same.sentence.startswith(words)


def test_designs_that_are_far_worse_do_not_hide_what_good_ones_differ_by() -> None:
    """A cliff, where a panel hides the light: 30 deg in a corner. The emulator predicts unseen good designs better."""
    plain = search((ERROR,))
    cliff = plain.places.sum(axis=1) > 1.75
    cliff[0] = False
    assert 1 <= cliff.sum() <= 4
    hidden = [
        one.model_copy(update={"values": {"error": 60.0}}) if is_hidden and not one.failure else one
        for one, is_hidden in zip(plain.evaluated, cliff, strict=True)
    ]
    found = replace(plain, evaluated=tuple(hidden))
    unseen = screening_designs(2, 64, 9)
    good = unseen[[error_of(x) < 3.0 for x in unseen]]
    true = np.log([error_of(x) for x in good])

    def rms(emulator: DesignEmulator) -> float:
        return float(np.sqrt(np.mean((emulator.mean(good) - true) ** 2)))

    told = rms(found.emulators(())[0])
    assert told < 0.5 * rms(fit_emulator(found.places[found.usable], found.losses[:, 0]))
    assert told < 2.0 * rms(plain.emulators(())[0])
    # what was computed there lies within its limits all the same
    for row in design_optimum(found, None, seed=1).designs:
        if row.values.get("error") == 60.0:
            assert row.expected_95["error"][1] >= 60.0 * (1.0 - 1e-12)


def test_the_front_is_the_trade(optimum: DesignOptimum) -> None:
    """On the true front the second input is 0.5 and the first at least 0.3."""
    on_front = [d for d in optimum.designs if d.p_front is not None and d.p_front > 0.5]
    assert optimum.designs[-1] in on_front
    start, failed = optimum.designs[0], optimum.designs[7]
    assert start.p_front is not None
    assert start.p_front < 0.05
    assert failed.p_front is None
    assert failed.failure
    for row in on_front:
        x, y = (value / 10.0 for value in row.changes.values())
        # beaten by the design of the same light at 0.5 by exp((y - 0.5)^2): 1 %, and what lies between sampled rivals
        assert (y - 0.5) ** 2 < 0.05
        assert x > 0.2


def test_real_differences_are_told_from_noise(optimum: DesignOptimum) -> None:
    chosen = optimum.designs[-1]
    assert chosen.better_than_chosen == chosen.worse_than_chosen == ()
    start = optimum.designs[0]
    assert start.worse_than_chosen == ("error",)
    assert start.better_than_chosen == ("light",)
    for row in optimum.designs:
        x = np.array(list(row.changes.values())) / 10.0
        if "error" in row.worse_than_chosen:
            assert error_of(x) > error_of(np.array([0.3, 0.5]))


def test_confirmed_gains_are_means_with_their_limits() -> None:
    found = search((ERROR,))
    rng = np.random.default_rng(0)
    # start 30 %, best of the screen 10 % worse than the chosen one, each time with noise of 1 %
    confirmed = np.log([1.3, 1.1, 1.0])[None, :, None] + 0.01 * rng.standard_normal((6, 3, 1))
    gains = design_optimum(found, confirmed, seed=1).gains
    for gain, ratio in zip(gains, (1.3, 1.1), strict=True):
        assert gain.confirmed_rel is not None
        assert gain.confirmed_95_rel is not None
        low, high = gain.confirmed_95_rel
        assert low < 1.0 - 1.0 / ratio < high
        assert gain.shrinkage_rel == pytest.approx(gain.seen_rel - gain.confirmed_rel)


def test_the_bound_on_what_could_be_gained_covers_it() -> None:
    """A chosen design that is 5 % from the optimum is found out, and the best one is not."""
    best = design_optimum(search((ERROR,)), None, seed=1)
    assert best.regret_95_rel < 0.01
    worse = search((ERROR,))
    off = np.array([0.3 + np.sqrt(0.025), 0.5])
    last = worse.evaluated[-1].model_copy(update={"values": {"error": error_of(off)}})
    places = np.concatenate([worse.places[:-1], off[None]])
    worse = DesignSearch(
        worse.objectives, worse.parameters, places, worse.changes, worse.roles, (*worse.evaluated[:-1], last)
    )
    found = design_optimum(worse, None, seed=1)
    true = 1.0 - 2.0 / error_of(off)
    assert 0.04 < true < found.regret_95_rel < 0.08


def test_what_could_be_gained_of_light_is_relative_to_the_chosen_design() -> None:
    """The best design is exp(0.8) times as bright, 123 % more; 55 %, its own loss, was told as the gain."""
    found = design_optimum(search((LIGHT,), 0.001, (0.2, 0.5)), None, seed=1)
    told = re.search(r"no design within the limits is better by more than ([0-9.]+) %", found.sentence)
    assert told is not None
    # three standard deviations of the noise of both designs, 0.1 % each, and the rounding of the sentence
    assert float(told[1]) / 100.0 == pytest.approx(np.expm1(0.8), abs=3 * np.sqrt(2.0) * 1e-3 * np.exp(0.8) + 5e-4)
    assert found.regret_95_rel == pytest.approx(1.0 - np.exp(-0.8), abs=3 * np.sqrt(2.0) * 1e-3)


def test_losses_weigh_ratios_alike() -> None:
    found = losses(np.array([[2.0, 4.0], [4.0, 2.0]]), (ERROR, LIGHT))
    np.testing.assert_allclose(found[1] - found[0], [np.log(2.0), np.log(2.0)])
