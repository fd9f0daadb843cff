"""Fits a law to one or several named tests by Levenberg-Marquardt (MINPACK, through scipy).

The unknowns of every law are linear coefficients w (shear moduli of its terms) and, for Ogden,
the exponents alpha. The stress of each term comes from the kernels, so there is no second
implementation of a law here. Residuals are assembled per data set, sorted by name: the order in
which the sets are given cannot matter.

Starts: many random draws of exponents (seeded), each with its best linear coefficients, of
which the best few are polished by Levenberg-Marquardt. Of all fits whose RMS residual is within
2 % of the least, the one with the least cancellation between its terms (smallest sum of
|mu_i alpha_i|) is returned: three Ogden terms on one test are not identifiable, and that rule
keeps the coefficients small. The certificate says how far the others differ.

A stable fit is stable in Drucker's sense in all three modes, tension and compression, up to the
largest first invariant ``l1**2 + l2**2 + l3**2`` of the data. Two families are tried. In the
first each linear coefficient is a square, so that every ``mu_i alpha_i >= 0`` (or c_i >= 0):
sufficient at every stretch, for each term's energy is then a convex function of the log
stretches. In the second the coefficients are free and states that are not stable add residuals;
a fit that still has one is refused. The better of both is returned.

The exponents are ``15 sin(x)`` of an unknown x, so that they stay within +-15: steeper terms
only follow noise near rest and make the other modes absurd.

References: J. J. More, The Levenberg-Marquardt algorithm, LNM 630 (1978) 105,
doi:10.1007/BFb0067700; R. W. Ogden, G. Saccomandi, I. Sgura, Comput. Mech. 34 (2004) 484,
doi:10.1007/s00466-004-0593-y (on the non-uniqueness of such fits).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.optimize import least_squares, nnls

from flexapod.core.errors import InputError, SolverError, Status
from flexapod.materials.data import TensileData
from flexapod.materials.kernels import principal_stresses
from flexapod.materials.law import HyperelasticLaw
from flexapod.materials.modes import (
    MODES,
    direction,
    equivalent_stretch,
    log_stretches,
    nominal_stress,
)
from flexapod.materials.mooney_rivlin import MooneyRivlin
from flexapod.materials.neo_hooke import NeoHooke
from flexapod.materials.ogden import Ogden
from flexapod.materials.registry import LAWS
from flexapod.materials.stability import (
    SEARCH_RANGE,
    StableRange,
    margins,
    stable_ranges,
    unstable_states,
)
from flexapod.materials.yeoh import Yeoh

WEIGHTS = ("absolute", "relative")
DEFAULT_TERMS = {"ogden": 3, "neo-hooke": 1, "mooney-rivlin": 2, "yeoh": 3}

_SEED = 20261122
_DRAWS = 400
_STARTS = 6  # starts polished a little ...
_FINALISTS = 3  # ... of which so many to the end
_ALPHA_LIMIT = 15.0
_SEARCH_POINTS = 200  # per set
# Stable fits: least margin asked for, over G, and how hard a violation pulls.
_MARGIN = 0.02
_PENALTY = 1.0
_ALPHA_GRID = np.concatenate([np.arange(-8.0, 0.0, 0.5), np.arange(0.5, 14.1, 0.5)])
# Relative weights: no stress counts as smaller than this part of the largest of its set.
_RELATIVE_FLOOR = 1e-3
# Fits this close to the best RMS residual count as equal when one is chosen, ...
_TIE = 1.02
# ... and this close when the band is drawn: 10 % above, or 0.1 % of the largest stress (about
# what a good load cell resolves), whichever is more.
_NEAR_FACTOR = 1.10
_NEAR_STRESS = 1e-3


@dataclass(frozen=True)
class Band:
    """Lowest and highest curve of all near-equally good fits in one mode."""

    mode: str
    measured: bool
    stretch: np.ndarray  # [-], shape (n,)
    low: np.ndarray  # nominal stress [Pa], shape (n,)
    high: np.ndarray  # nominal stress [Pa], shape (n,)
    best: np.ndarray  # the fit itself [Pa], shape (n,)

    @property
    def relative_width(self) -> float:
        """Largest ``(high - low) / |best|`` beyond stretches of 10 % from rest."""
        away = np.abs(self.stretch - 1.0) > 0.1
        if not away.any():
            return 0.0
        return float(np.max((self.high - self.low)[away] / np.abs(self.best[away])))


@dataclass(frozen=True)
class Certificate:
    """How well the data settle the coefficients."""

    condition_number: float  # of the Jacobian, columns in relative changes of the coefficients
    standard_errors: dict[str, list[float]]  # by coefficient word, in its unit; inf: not settled
    near_fit_count: int  # fits the bands are drawn from
    bands: dict[str, Band]


@dataclass(frozen=True)
class FitResult:
    """A fitted law and what is known about it."""

    law: HyperelasticLaw
    data: tuple[TensileData, ...]  # sorted by name
    weights: str
    stable_requested: bool
    r_squared: float  # on all points read, fitted or not
    r_squared_by_set: dict[str, float]
    rms_relative_error: float  # on the fitted points
    points_used: int
    points_read: int
    stable: dict[str, StableRange]
    certificate: Certificate
    near_fits: tuple[HyperelasticLaw, ...] = field(repr=False)
    warnings: tuple[str, ...] = ()

    @property
    def youngs_modulus(self) -> float:
        """E = 3 G [Pa]: the law is incompressible."""
        return 3.0 * self.law.shear_modulus

    def as_json(self) -> dict[str, Any]:
        """The object ``flexapod fit --json`` prints; every number is finite or null."""
        coefficients = self.law.coefficients()
        parameters = self.law.parameters()
        result: dict[str, Any] = {
            "model": self.law.name,
            "mu_Pa": [float(v) for v in parameters.mu],
            "alpha": [float(v) for v in parameters.alpha],
        }
        if "c" in coefficients:
            result["c_Pa"] = coefficients["c"]
        result |= {
            "convention": "W = sum mu/alpha (l1^alpha + l2^alpha + l3^alpha - 3)",
            "shear_modulus_Pa": self.law.shear_modulus,
            "youngs_modulus_Pa": self.youngs_modulus,
            "r_squared": self.r_squared,
            "r_squared_by_set": self.r_squared_by_set,
            "rms_relative_error": self.rms_relative_error,
            "stable_stretch": {m: r.as_list() for m, r in self.stable.items()},
            "stable_limit": {m: [r.low_limit, r.high_limit] for m, r in self.stable.items()},
            "points_used": self.points_used,
            "points_read": self.points_read,
            "weights": self.weights,
            "stable_requested": self.stable_requested,
            "data": [
                {
                    "name": d.name,
                    "mode": d.mode,
                    "points_read": int(d.stretch.size),
                    "points_used": int(d.fitted.sum()),
                    "stretch": [float(d.stretch.min()), float(d.stretch.max())],
                }
                for d in self.data
            ],
            "certificate": {
                "condition_number": self.certificate.condition_number,
                "standard_errors": self.certificate.standard_errors,
                "near_fit_count": self.certificate.near_fit_count,
                "bands": {
                    mode: {
                        "measured": band.measured,
                        "relative_width": band.relative_width,
                        "stretch": band.stretch[::6].tolist(),
                        "low_Pa": band.low[::6].tolist(),
                        "high_Pa": band.high[::6].tolist(),
                    }
                    for mode, band in self.certificate.bands.items()
                },
            },
            "warnings": list(self.warnings),
        }
        finite: dict[str, Any] = _finite(result)
        return finite


def _finite(value: Any) -> Any:
    """Replace numbers JSON cannot write by None."""
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_finite(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


class _Problem:
    """Residuals of one law on the sets, as functions of (w, alpha)."""

    def __init__(self, model: str, terms: int, data: tuple[TensileData, ...], weights: str) -> None:
        self.model = model
        self.terms = terms
        self.data = data
        largest = max(float(np.abs(d.stress[d.fitted]).max()) for d in data)
        self.scale = largest  # [Pa]; residuals are stresses over it, or relative
        blocks = []
        for d in data:
            size = np.abs(d.stress[d.fitted])
            if weights == "absolute":
                blocks.append(np.full(size.shape, 1.0 / largest))
            else:
                blocks.append(1.0 / np.maximum(size, _RELATIVE_FLOOR * size.max()))
        self.weight = np.concatenate(blocks)
        self.target = np.concatenate([d.stress[d.fitted] for d in data]) * self.weight
        self.root_count = math.sqrt(self.target.size)
        stretch = np.concatenate([d.stretch[d.fitted] for d in data])
        self.logs = np.concatenate([log_stretches(d.mode, d.stretch[d.fitted]) for d in data])
        self.nominal_weight = self.weight / stretch
        self.states = asked_states(data)

    @property
    def exponent_count(self) -> int:
        return self.terms if self.model == "ogden" else 0

    def term_law(self, term: int, alpha: float) -> HyperelasticLaw:
        """Term `term` with unit linear coefficient."""
        if self.model == "ogden":
            a = float(np.clip(alpha, -_ALPHA_LIMIT, _ALPHA_LIMIT))
            a = math.copysign(max(abs(a), 1e-6), a)
            return Ogden((2.0 / a,), (a,))
        if self.model == "neo-hooke":
            return NeoHooke(1.0)
        if self.model == "mooney-rivlin":
            return MooneyRivlin(1.0, 0.0) if term == 0 else MooneyRivlin(0.0, 1.0)
        return Yeoh(*(1.0 if i == term else 0.0 for i in range(3)))

    def column(self, law: HyperelasticLaw) -> np.ndarray:
        """Weighted nominal stress of `law` at the fitted points, shape (point_count,)."""
        tau = principal_stresses(*law.parameters(), self.logs)
        result: np.ndarray = (tau[:, 0] - tau[:, 2]) * self.nominal_weight
        return result

    def is_stable(self, law: HyperelasticLaw) -> bool:
        """Whether `law` is stable in all states asked for."""
        return not unstable_states(law, self.states).any()

    def columns(self, alpha: np.ndarray) -> np.ndarray:
        """Unit columns of all terms, shape (point_count, term_count)."""
        exponents = alpha if self.exponent_count else np.zeros(self.terms)
        return np.stack(
            [self.column(self.term_law(k, float(a))) for k, a in enumerate(exponents)], axis=1
        )

    def law(self, w: np.ndarray, alpha: np.ndarray) -> HyperelasticLaw:
        """The law of linear coefficients `w` [Pa], terms in ascending order of alpha."""
        if self.model == "ogden":
            a = np.clip(alpha, -_ALPHA_LIMIT, _ALPHA_LIMIT)
            a = np.where(np.abs(a) < 1e-6, np.copysign(1e-6, a), a)
            order = np.lexsort((w, a))
            return Ogden(tuple((2.0 * w / a)[order]), tuple(a[order]))
        if self.model == "neo-hooke":
            return NeoHooke(max(float(w[0]), 1e-300))
        if self.model == "mooney-rivlin":
            return MooneyRivlin(float(w[0]), float(w[1]))
        return Yeoh(*(float(v) for v in w))

    def unknowns(self, law: HyperelasticLaw) -> tuple[np.ndarray, np.ndarray]:
        """(w, alpha) of a law of this model, the reverse of `law`."""
        p = law.parameters()
        if self.model == "ogden":
            return 0.5 * p.mu * p.alpha, p.alpha
        values = next(iter(law.coefficients().values()))
        return np.array(values[: self.terms]), np.zeros(0)

    def rms(self, law: HyperelasticLaw) -> float:
        """RMS weighted residual of a law."""
        r = self.column(law) - self.target
        value = float(np.linalg.norm(r)) / self.root_count
        return value if math.isfinite(value) else math.inf

    def linear(self, columns: np.ndarray, target: np.ndarray, positive: bool) -> np.ndarray:
        """Best linear coefficients [Pa] for given columns."""
        size = np.linalg.norm(columns, axis=0)
        size[size == 0.0] = 1.0
        if positive:
            w, _ = nnls(columns / size, target)
        else:
            w = np.linalg.lstsq(columns / size, target, rcond=1e-10)[0]
        result: np.ndarray = w / size
        return result

    def polish(
        self,
        w: np.ndarray,
        alpha: np.ndarray,
        *,
        square: bool = False,
        guard: bool = False,
        evaluations: int = 300,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Levenberg-Marquardt from (w, alpha).

        With `square`, w is the square of an unknown; with `guard`, states that are not stable
        add residuals.
        """
        n = self.terms
        unit = self.scale  # unknowns near 1
        # A zero square has a zero slope: start a little above it.
        start_w = np.sqrt(np.maximum(w / unit, 1e-6)) if square else w / unit
        exponents = np.arcsin(np.clip(alpha / _ALPHA_LIMIT, -0.999, 0.999))
        start = np.concatenate([start_w, exponents]) if self.exponent_count else start_w

        def split(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return (x[:n] ** 2 if square else x[:n]) * unit, _ALPHA_LIMIT * np.sin(x[n:])

        def guards(x: np.ndarray) -> np.ndarray:
            v, a = split(x)
            law = self.law(v, a)
            # asinh keeps the pull of far-off states, where moduli are huge, within bounds.
            margin = np.arcsinh(margins(law, self.states) / unit)
            return np.asarray(_PENALTY * np.maximum(0.0, _MARGIN - margin))

        def residual(x: np.ndarray) -> np.ndarray:
            v, a = split(x)
            r = self.columns(a) @ v - self.target
            r = np.concatenate([r, guards(x)]) if guard else r
            return np.asarray(np.nan_to_num(r, nan=1e6, posinf=1e6, neginf=-1e6))

        def jacobian(x: np.ndarray) -> np.ndarray:
            v, a = split(x)
            columns = self.columns(a)
            parts = [columns * (2.0 * x[:n] if square else np.ones(n)) * unit]
            step = 1e-5
            if a.size:
                # Central differences of a smooth column: error about 1e-10 of it.
                slope = (self.columns(a + step) - self.columns(a - step)) / (2.0 * step)
                parts.append(slope * v * (_ALPHA_LIMIT * np.cos(x[n:])))
            top = np.concatenate(parts, axis=1)
            if not guard:
                return top
            steps = 1e-6 * np.eye(x.size)
            low = [(guards(x + h) - guards(x - h)) / 2e-6 for h in steps]
            return np.nan_to_num(np.concatenate([top, np.stack(low, axis=1)], axis=0))

        solution = least_squares(
            residual,
            start,
            jac=jacobian,
            method="lm",
            x_scale="jac",
            ftol=1e-12,
            xtol=1e-12,
            gtol=1e-14,
            max_nfev=evaluations,
        )
        return split(solution.x)


def fit_law(
    data: Iterable[TensileData],
    model: str = "ogden",
    terms: int | None = None,
    *,
    weights: str = "absolute",
    stable: bool = False,
    seed: int = _SEED,
) -> FitResult:
    """Fit a law to one or several tests at once.

    Parameters
    ----------
    data
        The tests, each with its own name; their order does not matter.
    model
        "ogden", "neo-hooke", "mooney-rivlin" or "yeoh".
    terms
        Number of Ogden terms (default 3), or of Yeoh's (1 to 3).
    weights
        "absolute": residuals in stress; "relative": residuals over the measured stress.
    stable
        Ask for a law that is stable in Drucker's sense at every stretch.
    seed
        Of the random starts; the same seed gives the same fit.
    """
    sets, count = _checked(data, model, terms, weights)
    problem = _Problem(model, count, sets, weights)
    rng = np.random.default_rng(seed)

    # Long files are searched on some of their points and polished on all.
    some = _Problem(model, count, tuple(_thinned(d) for d in sets), weights)
    found, polished = _search(some, rng, square=False)
    if stable or model == "ogden":
        # Without --stable too: where squares fit as well, they cancel least.
        squares, square_starts = _search(some, rng, square=True)
        found += squares
        polished += square_starts
    if model != "neo-hooke":
        for w, alpha in polished if stable else polished[:2]:
            found.append(some.law(*some.polish(w, alpha, guard=True, evaluations=150)))
    if some.target.size < problem.target.size:
        best = sorted((law for law in found if law.shear_modulus > 0.0), key=some.rms)
        for law in best[:_FINALISTS]:
            w, alpha = some.unknowns(law)
            guard = some.is_stable(law)
            found.append(problem.law(*problem.polish(w, alpha, guard=guard, evaluations=60)))
    candidates = [(problem.rms(law), law) for law in found]
    usable = [
        (r, law)
        for r, law in candidates
        if r < math.inf and law.shear_modulus > 0.0 and (not stable or problem.is_stable(law))
    ]
    if not usable:
        raise SolverError(
            Status.NOT_CONVERGED,
            f"no {'stable ' if stable else ''}{model} law with a positive shear modulus fits the "
            "data: use fewer terms or --stable, or check the sign of the stress column",
        )
    least = min(r for r, _ in usable)
    limit = _near_limit(least) if stable else _TIE * least + 1e-12
    ties = [(r, law) for r, law in usable if r <= limit]
    if model != "ogden":
        ties = [min(ties, key=lambda item: item[0])]

    def preference(rated: tuple[float, HyperelasticLaw]) -> tuple[bool, float, float]:
        # The residual settles what cancellation leaves equal, so that the choice is unique.
        rms, law = rated
        return not problem.is_stable(law), round(_cancellation(law), 6), rms

    best_rms, law = min(ties, key=preference)

    near = _near_fits(problem, law, best_rms, [c[1] for c in usable], stable)
    asked = asked_ranges(sets).values()
    search = (
        min([SEARCH_RANGE[0]] + [0.9 * low for low, _ in asked]),
        max([SEARCH_RANGE[1]] + [1.1 * high for _, high in asked]),
    )
    ranges = stable_ranges(law, search)
    condition, errors = _certainty(problem, law)
    certificate = Certificate(condition, errors, len(near), _bands(law, near, sets))
    per_set, r_squared = _r_squared(law, sets)
    fitted = [(d.stress[d.fitted], nominal_stress(law, d.mode, d.stretch[d.fitted])) for d in sets]
    relative = np.concatenate([(p - s) / s for s, p in fitted])
    return FitResult(
        law=law,
        data=sets,
        weights=weights,
        stable_requested=stable,
        r_squared=r_squared,
        r_squared_by_set=per_set,
        rms_relative_error=float(np.sqrt(np.mean(relative**2))),
        points_used=int(sum(d.fitted.sum() for d in sets)),
        points_read=int(sum(d.stretch.size for d in sets)),
        stable=ranges,
        certificate=certificate,
        near_fits=tuple(near),
        warnings=tuple(_warnings(law, sets, ranges, certificate)),
    )


def _thinned(data: TensileData) -> TensileData:
    """At most `_SEARCH_POINTS` of the fitted points, evenly taken, the ends among them."""
    fitted = np.flatnonzero(data.fitted)
    if fitted.size <= _SEARCH_POINTS:
        return data
    pick = fitted[np.unique(np.linspace(0, fitted.size - 1, _SEARCH_POINTS).round().astype(int))]
    return TensileData(
        data.name, data.mode, data.stretch[pick], data.stress[pick], np.ones(pick.size, dtype=bool)
    )


def _checked(
    data: Iterable[TensileData], model: str, terms: int | None, weights: str
) -> tuple[tuple[TensileData, ...], int]:
    sets = tuple(sorted(data, key=lambda d: d.name))
    if not sets:
        raise InputError("needs at least one data set", "fit")
    names = [d.name for d in sets]
    if len(set(names)) != len(names):
        raise InputError(f"data sets need different names, got {', '.join(names)}", "fit")
    if model not in LAWS:
        raise InputError(f'model must be one of {", ".join(LAWS)}; got "{model}"', "fit")
    if weights not in WEIGHTS:
        raise InputError(f'weights must be one of {", ".join(WEIGHTS)}; got "{weights}"', "fit")
    count = DEFAULT_TERMS[model] if terms is None else terms
    allowed = {"ogden": range(1, 9), "yeoh": range(1, 4)}.get(model)
    if allowed is not None and count not in allowed:
        raise InputError(
            f"{model} takes {allowed.start} to {allowed.stop - 1} terms, got {count}", "fit"
        )
    if allowed is None and count != DEFAULT_TERMS[model]:
        raise InputError(f"{model} has a fixed number of terms: leave out --terms", "fit")
    unknowns = 2 * count if model == "ogden" else count
    points = int(sum(d.fitted.sum() for d in sets))
    if points < unknowns:
        raise InputError(
            f"{points} points cannot settle the {unknowns} coefficients of {model} with {count} "
            "terms: use fewer terms or more data",
            "fit",
        )
    return sets, count


_Laws = list[HyperelasticLaw]
_Starts = list[tuple[np.ndarray, np.ndarray]]  # (w, alpha)


def _search(problem: _Problem, rng: np.random.Generator, *, square: bool) -> tuple[_Laws, _Starts]:
    """Random exponents with their best linear coefficients, the best of them polished.

    Returns every good law met, and the (w, alpha) the polishing ended at.
    """
    found: _Laws = []
    ends: _Starts = []
    n = problem.terms
    if not problem.exponent_count:
        none = np.zeros(0)
        w = problem.linear(problem.columns(none), problem.target, square)
        w, _ = problem.polish(w, none, square=square)
        return [problem.law(w, none)], [(w, none)]

    grid = np.stack([problem.column(problem.term_law(0, float(a))) for a in _ALPHA_GRID], axis=1)
    # One QR makes each of the many small least-squares problems as short as the grid.
    size = np.linalg.norm(grid, axis=0)
    q, short = np.linalg.qr(grid / size)
    target = q.T @ problem.target
    rest = max(float(problem.target @ problem.target - target @ target), 0.0)
    draws: list[tuple[float, tuple[int, ...], np.ndarray]] = []
    seen: set[tuple[int, ...]] = set()
    for _ in range(_DRAWS):
        pick = tuple(sorted(rng.choice(_ALPHA_GRID.size, size=n, replace=False).tolist()))
        if pick in seen:
            continue
        seen.add(pick)
        columns = short[:, list(pick)]
        w = problem.linear(columns, target, square)
        rms = math.sqrt(rest + float(np.sum((columns @ w - target) ** 2))) / problem.root_count
        draws.append((rms, pick, w / size[list(pick)]))
    draws.sort(key=lambda item: (item[0], item[1]))
    for _, pick, w in draws[:60]:
        found.append(problem.law(w, _ALPHA_GRID[list(pick)]))
    rated: list[tuple[float, np.ndarray, np.ndarray]] = []
    for _, pick, w in draws[:_STARTS]:
        w, a = problem.polish(w, _ALPHA_GRID[list(pick)], square=square, evaluations=40)
        rated.append((problem.rms(problem.law(w, a)), w, a))
    rated.sort(key=lambda item: item[0])
    for k, (_, w, a) in enumerate(rated):
        if k < _FINALISTS:
            w, a = problem.polish(w, a, square=square)
            ends.append((w, a))
        found.append(problem.law(w, a))
    return found, ends


def _cancellation(law: HyperelasticLaw) -> float:
    """Sum of the sizes of the terms' shear moduli over the shear modulus; 1 without any."""
    p = law.parameters()
    total = 0.5 * float(np.abs(p.mu * p.alpha).sum()) + 2.0 * abs(float(p.c[0]))
    return total / law.shear_modulus


def _coefficient_columns(
    problem: _Problem, law: HyperelasticLaw
) -> tuple[np.ndarray, np.ndarray, list[tuple[str, int]]]:
    """Jacobian of the weighted residuals by reported coefficient, with values and words."""
    columns: list[np.ndarray] = []
    values: list[float] = []
    words: list[tuple[str, int]] = []
    if isinstance(law, Ogden):
        for k, (mu, alpha) in enumerate(zip(law.mu, law.alpha, strict=True)):
            columns.append(problem.column(Ogden((1.0,), (alpha,))))
            values.append(mu)
            words.append(("mu", k))
        for k, (mu, alpha) in enumerate(zip(law.mu, law.alpha, strict=True)):
            step = 1e-5
            high = problem.column(Ogden((mu,), (alpha + step,)))
            low = problem.column(Ogden((mu,), (alpha - step,)))
            columns.append((high - low) / (2.0 * step))
            values.append(alpha)
            words.append(("alpha", k))
    else:
        word = next(iter(law.coefficients()))
        for k, value in enumerate(law.coefficients()[word][: problem.terms]):
            columns.append(problem.column(problem.term_law(k, 0.0)))
            values.append(value)
            words.append((word, k))
    return np.stack(columns, axis=1), np.array(values), words


def _certainty(problem: _Problem, law: HyperelasticLaw) -> tuple[float, dict[str, list[float]]]:
    """Condition number of the relative Jacobian, and standard errors by word."""
    jacobian, values, words = _coefficient_columns(problem, law)
    magnitude = np.where(values != 0.0, np.abs(values), 1.0)
    _, singular, right = np.linalg.svd(jacobian * magnitude, full_matrices=False)
    condition = float(singular[0] / singular[-1]) if singular[-1] > 0.0 else math.inf
    freedom = max(problem.target.size - values.size, 1)
    residual = problem.column(law) - problem.target
    variance = float(residual @ residual) / freedom
    settled = singular > singular[0] * 1e-14
    with np.errstate(divide="ignore", invalid="ignore"):
        terms = np.where(settled[:, None], right / singular[:, None], np.inf * (right != 0.0))
    spread = np.sqrt(variance * np.nansum(terms**2, axis=0)) * magnitude
    errors: dict[str, list[float]] = {}
    for (word, _), error in zip(words, spread, strict=True):
        errors.setdefault(word, []).append(float(error))
    return condition, errors


def _near_fits(
    problem: _Problem,
    law: HyperelasticLaw,
    best_rms: float,
    candidates: Sequence[HyperelasticLaw],
    stable: bool,
) -> list[HyperelasticLaw]:
    """All laws found that fit nearly as well, and the furthest along the uncertain directions."""
    limit = _near_limit(best_rms)

    def allowed(other: HyperelasticLaw) -> bool:
        if other.shear_modulus <= 0.0 or problem.rms(other) > limit:
            return False
        return not stable or problem.is_stable(other)

    near = [law] + [c for c in candidates if c is not law and allowed(c)]
    jacobian, values, _ = _coefficient_columns(problem, law)
    magnitude = np.where(values != 0.0, np.abs(values), 1.0)
    _, singular, right = np.linalg.svd(jacobian * magnitude, full_matrices=False)
    for row, size in zip(right, singular, strict=True):
        for sign in (1.0, -1.0):
            # Where the linear model reaches the limit, then back until the law itself does.
            step = min(limit * problem.root_count / max(float(size), 1e-300), 1.0)
            for _ in range(40):
                other = _shifted(law, values + sign * step * row * magnitude)
                if other is not None and allowed(other):
                    near.append(other)
                    break
                step *= 0.7
    return near


def _near_limit(best_rms: float) -> float:
    """RMS residual up to which a fit counts as nearly as good."""
    return max(_NEAR_FACTOR * best_rms, best_rms + _NEAR_STRESS)


def _shifted(law: HyperelasticLaw, values: np.ndarray) -> HyperelasticLaw | None:
    """`law` with other coefficients, or None if they are not allowed."""
    try:
        if isinstance(law, Ogden):
            n = len(law.mu)
            return Ogden(tuple(values[:n]), tuple(values[n:]))
        return type(law)(*(float(v) for v in values))
    except InputError:
        return None


def asked_ranges(data: Iterable[TensileData]) -> dict[str, tuple[float, float]]:
    """Return, per mode, the stretches a law fitted to `data` is asked for.

    Tension and compression of every mode up to the largest first invariant
    ``l1**2 + l2**2 + l3**2`` of the data: their range and its equivalents. (Uniaxial tension by l
    is equibiaxial compression by l**-1/2, the same state.)
    """
    largest = max(
        (
            (float(np.exp(2.0 * log_stretches(d.mode, np.array([end]))).sum()), d.mode, float(end))
            for d in data
            for end in (d.stretch.min(), d.stretch.max())
        ),
    )
    _, source, end = largest
    pulled = end if end > 1.0 else _other_side(source, end)
    return {
        mode: (
            _other_side(mode, equivalent_stretch(source, pulled, mode)),
            pulled if mode == source else equivalent_stretch(source, pulled, mode),
        )
        for mode in MODES
    }


def _other_side(mode: str, stretch: float) -> float:
    """The stretch beyond rest with the same first invariant."""
    way = direction(mode)
    target = float(np.exp(2.0 * math.log(stretch) * way).sum())
    sign = -1.0 if stretch > 1.0 else 1.0
    low, high = 0.0, 60.0
    for _ in range(100):
        middle = 0.5 * (low + high)
        value = float(np.exp(np.minimum(2.0 * sign * middle * way, 600.0)).sum())
        low, high = (middle, high) if value < target else (low, middle)
    return math.exp(sign * 0.5 * (low + high))


def asked_states(data: Iterable[TensileData], count: int = 25) -> np.ndarray:
    """Principal log stretches over `asked_ranges`, rest included, shape (n, 3)."""
    blocks = [np.zeros((1, 3))]
    for mode, ends in asked_ranges(data).items():
        for end in ends:
            h = np.linspace(0.0, math.log(end), count + 1)[1:]
            blocks.append(h[:, None] * direction(mode))
    return np.concatenate(blocks)


def _bands(
    law: HyperelasticLaw, near: Sequence[HyperelasticLaw], sets: tuple[TensileData, ...]
) -> dict[str, Band]:
    measured = {d.mode for d in sets}
    bands = {}
    for mode, (_, high) in asked_ranges(sets).items():
        low = min([1.0] + [float(d.stretch.min()) for d in sets if d.mode == mode])
        stretch = np.exp(np.linspace(math.log(low), math.log(high), 61))
        curves = np.stack([nominal_stress(other, mode, stretch) for other in near])
        bands[mode] = Band(
            mode,
            mode in measured,
            stretch,
            curves.min(axis=0),
            curves.max(axis=0),
            nominal_stress(law, mode, stretch),
        )
    return bands


def _r_squared(
    law: HyperelasticLaw, sets: tuple[TensileData, ...]
) -> tuple[dict[str, float], float]:
    """R2 per set and of all sets together (each about its own mean), on all points read."""
    per_set: dict[str, float] = {}
    residuals = totals = 0.0
    for d in sets:
        misfit = float(np.sum((nominal_stress(law, d.mode, d.stretch) - d.stress) ** 2))
        spread = float(np.sum((d.stress - d.stress.mean()) ** 2))
        per_set[d.name] = 1.0 - misfit / spread if spread > 0.0 else math.nan
        residuals += misfit
        totals += spread
    return per_set, 1.0 - residuals / totals if totals > 0.0 else math.nan


def _warnings(
    law: HyperelasticLaw,
    sets: tuple[TensileData, ...],
    ranges: dict[str, StableRange],
    certificate: Certificate,
) -> list[str]:
    said = [note for d in sets for note in d.notes]
    for d in sets:
        for end in (float(d.stretch.min()), float(d.stretch.max())):
            if not ranges[d.mode].contains(end):
                stable = ranges[d.mode]
                said.append(
                    f"unstable: {d.name} reaches a stretch of {end:.4g} in {d.mode}, but the law "
                    f"is stable only from {stable.low:.4g} to {stable.high:.4g}; ask for a stable "
                    "fit (--stable)"
                )
    for mode, (low, high) in asked_ranges(sets).items():
        stable = ranges[mode]
        if not (stable.contains(low) and stable.contains(high)):
            said.append(
                f"unstable: deformations as large as the data's are stretches of {low:.4g} to "
                f"{high:.4g} in {mode}, where the law is stable only from {stable.low:.4g} to "
                f"{stable.high:.4g}"
            )
    for mode, band in certificate.bands.items():
        if not band.measured and band.relative_width > 0.1:
            width = band.relative_width
            how = f"up to {100 * width:.0f} %" if width < 10.0 else "more than ten times"
            said.append(
                f"not-measured: near-equally good fits differ by {how} in {mode}, which was not "
                "measured"
            )
    if certificate.condition_number > 1e4 and law.name == "ogden":
        said.append(
            f"not-identifiable: the coefficients are not settled by these data (condition "
            f"{certificate.condition_number:.1e}); compare curves, not coefficients"
        )
    if any(abs(a) > 0.999 * _ALPHA_LIMIT for a in law.parameters().alpha):
        said.append(
            f"exponent-limit: an exponent ended at the limit of {_ALPHA_LIMIT:g}: use fewer terms"
        )
    return said
