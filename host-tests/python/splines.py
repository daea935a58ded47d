"""B-splines by SciPy, to compare them with this project's own.

Reads JSON on standard input and writes JSON:

  splines  {order, knots, control, x}       -> value, slope and curvature at each x
  fits     {order, knots, x, y, weight}     -> the control points of the least squares spline
  curves   {x, y, tolerance}                -> the fewest coefficients with which every residual is
                                               within the tolerance, and seconds, of
           splrep   FITPACK's smoothing spline, s scanned from coarse to fine
           its_knots  make_lsq_spline in the knots that splrep found
           even     make_lsq_spline in evenly spaced knots
"""

import json
import sys
import time
import warnings

import numpy as np
from scipy.interpolate import BSpline, make_lsq_spline, splev, splrep

# splrep says so when s cannot be met; the next s is tried then.
warnings.simplefilter("ignore")


def values(spline):
    x = np.array(spline["x"])
    curve = BSpline(np.array(spline["knots"]), np.array(spline["control"]), spline["order"] - 1)
    # A derivative beyond the degree is zero.
    return [
        curve(x, nu=nu).tolist() if nu < spline["order"] else [0.0] * len(x) for nu in range(3)
    ]


def least_squares(fit):
    # SciPy's weights multiply the residual, ours its square.
    weight = np.sqrt(np.array(fit["weight"]))
    x, y, knots = (np.array(fit[name]) for name in ("x", "y", "knots"))
    return make_lsq_spline(x, y, knots, fit["order"] - 1, weight).c.tolist()


def fewest(curve):
    x, y, tolerance = np.array(curve["x"]), np.array(curve["y"]), curve["tolerance"]

    def is_within(found):
        return np.max(np.abs(y - found)) <= tolerance

    best = {"splrep": None, "its_knots": None, "even": None}
    seconds = {}
    knots_seen = {}
    started = time.perf_counter()
    for s in len(x) * tolerance**2 * np.geomspace(1.0, 1e-3, 60):
        found = splrep(x, y, s=s)
        count = len(found[0]) - 4
        knots_seen.setdefault(count, found[0])
        if is_within(splev(x, found)):
            best["splrep"] = min(count, best["splrep"] or count)
    seconds["splrep"] = time.perf_counter() - started

    def first_within(knots_by_count):
        for count, knots in knots_by_count:
            try:
                if is_within(make_lsq_spline(x, y, knots, 3)(x)):
                    return count
            except (ValueError, np.linalg.LinAlgError):
                continue
        return None

    best["its_knots"] = first_within(sorted(knots_seen.items()))
    started = time.perf_counter()
    ends = [x[0]] * 4, [x[-1]] * 4
    best["even"] = first_within(
        (n + 4, np.r_[ends[0], np.linspace(x[0], x[-1], n + 2)[1:-1], ends[1]])
        for n in range(len(x) - 4)
    )
    seconds["even"] = time.perf_counter() - started
    return {"fewest": best, "seconds": seconds}


asked = json.load(sys.stdin)
json.dump(
    {
        "splines": [values(spline) for spline in asked["splines"]],
        "fits": [least_squares(fit) for fit in asked["fits"]],
        "curves": [fewest(curve) for curve in asked["curves"]],
    },
    sys.stdout,
)
