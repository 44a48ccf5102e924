#!/usr/bin/env python3
"""Writes exact-map-further.json: trajectories of the dimensionless display [6] in
arithmetic of 80 digits, as an oracle for the closed-form map of plant-sim.

Needs mpmath. The seed is fixed, so the file is the same every time:
    python3 tests/data/exact_map.py > tests/data/exact-map-further.json
"""
import json
import random

from mpmath import mp, mpf, exp, floor, log, nstr

mp.dps = 80


def held(mu, beta, x, v, d, t):
    """Position and velocity after t under the constant net force d."""
    if beta == 0:
        return x + v * t + d * t * t / (2 * mu), v + d * t / mu
    a = beta / mu
    end = d / beta
    return x + end * t + (v - end) * (1 - exp(-a * t)) / a, end + (v - end) * exp(-a * t)


def sign(v):
    return (v > 0) - (v < 0)


def sample(mu, beta, sigma, x, v):
    """One interval: at most one reversal, from the textbook solution."""
    phi = -(floor(x) + mpf(1) / 2)
    s = sign(v)
    if s == 0:
        if abs(phi) <= sigma:
            return x, v
        s = sign(phi)
    d = phi - sigma * s
    x1, v1 = held(mu, beta, x, v, d, mpf(1))
    if v == 0 or sign(v1) * s >= 0:
        return x1, v1
    t = -mu * v / d if beta == 0 else log(1 - beta * v / d) * mu / beta
    x2, _ = held(mu, beta, x, v, d, t)
    if abs(phi) <= sigma:
        return x2, mpf(0)
    return held(mu, beta, x2, mpf(0), phi + sigma * s, 1 - t)


def rests(sigma, x, v):
    return v == 0 and abs(floor(x) + mpf(1) / 2) <= sigma


def run(mu, beta, sigma, x, v, n):
    """The state after n samples, how close any sample came to a count edge, and the
    largest magnitude that was rounded on the way."""
    near, largest = mpf(1), max(abs(x), abs(v))
    for _ in range(n):
        if rests(sigma, x, v):
            break
        x, v = sample(mu, beta, sigma, x, v)
        near = min(near, abs(x - floor(x + mpf(1) / 2)))
        largest = max(largest, abs(x), abs(v))
    return x, v, near, largest


def draw(rng, tag):
    log10 = lambda low, high: 10 ** rng.uniform(low, high)
    mu, beta, sigma = log10(-1, 3), rng.uniform(0, 2), rng.uniform(0, 2)
    xi0, v0, n = rng.uniform(-50, 50), rng.uniform(-50, 50), rng.randrange(1, 150)
    if tag == "displaced":
        v0 = 0.0
    elif tag == "tiny_a":
        beta = log10(-16, -6)
    elif tag == "series_switch":  # beta/mu about 1/32 and 1/2, where the forms change
        beta = mu * rng.choice([1 / 32, 0.5, 0.405]) * (1 + rng.uniform(-1e-3, 1e-3))
    elif tag == "huge_a":
        mu, beta = log10(-4, -2), rng.uniform(0.5, 20)
    elif tag == "fast":
        v0, n = rng.choice([-1, 1]) * log10(3, 6), rng.randrange(1, 40)
    elif tag == "reverses_often":  # a limit cycle about one edge
        sigma, xi0, v0, n = rng.uniform(0, 0.3), rng.uniform(-1, 1), rng.uniform(-1, 1), 150
    return dict(tag=tag, mu=mu, beta=beta, sigma=sigma, xi0=xi0, v0=v0, n=n)


def main():
    rng = random.Random(20050318)
    cases = []
    tags = ["any", "displaced", "tiny_a", "series_switch", "huge_a", "fast", "reverses_often"]
    while len(cases) < 140:
        case = draw(rng, tags[len(cases) % len(tags)])
        start = [mpf(case[key]) for key in ("mu", "beta", "sigma", "xi0", "v0")]
        x, v, near, largest = run(*start, case["n"])
        # A sample within rounding of an edge may fall to either side; a diverged run has no
        # digits left to compare.
        if near < mpf(10) ** -9 or abs(x) > 10**8:
            continue
        case |= {"largest": float(largest), "xi": nstr(x, 30), "v": nstr(v, 30)}
        cases.append(case)
    print(json.dumps({"tolerance": "1e-12 * max(1, largest)", "cases": cases}, indent=0))


main()
