"""MuJoCo's Python binding and SciPy behind the line protocol of `cargo xtask peers`.

The display, the window rule and the protocol are those of peer.c. Settings: `mujoco`, one step of mj_step a
sample by Euler's method, and `scipy`, solve_ivp (DOP853) over every sample with the reversal as an event.
"""

import math
import signal
import sys
import time

import mujoco
import numpy
import scipy
from scipy.integrate import solve_ivp

WINDOW = 2000
DIVERGED_COUNTS, CONVERGED_SPEED, GROWTH = 1e9, 0.01, 1.02
TOLERANCE = 1e-10

MODEL = """<mujoco><option timestep='1' gravity='0 0 0' solver='PGS'><flag equality='disable' limit='disable'
contact='disable' spring='disable' gravity='disable' clampctrl='disable' actuation='disable' sensor='disable'
island='disable' autoreset='disable' warmstart='disable'/></option><worldbody><body>
<inertial pos='0 0 0' mass='{mu!r}' diaginertia='1 1 1'/>
<joint type='slide' axis='1 0 0' damping='1' frictionloss='1'/></body></worldbody></mujoco>"""


def mujoco_engine(mu):
    """A function from beta, sigma, v0 to one from phi to the position and velocity after the next sample."""
    model = mujoco.MjModel.from_xml_string(MODEL.format(mu=mu))
    data = mujoco.MjData(model)

    def start(beta, sigma, v0):
        model.dof_damping[0], model.dof_frictionloss[0] = beta, sigma
        mujoco.mj_resetData(model, data)
        position, velocity, force = data.qpos, data.qvel, data.qfrc_applied
        velocity[0] = v0

        def sample(phi):
            force[0] = phi
            mujoco.mj_step(model, data)
            return position[0], velocity[0]

        return sample

    return start


def scipy_engine(mu):
    """As mujoco_engine. Friction keeps its sign up to the event, where the display sticks or turns."""

    def start(beta, sigma, v0):
        state = numpy.array([0.0, v0])

        def reversal(_, y):
            return y[1]

        reversal.terminal = True

        def sample(phi):
            nonlocal state
            begin = 0.0
            while begin < 1:
                if state[1] != 0:
                    sign = math.copysign(1, state[1])
                elif abs(phi) > sigma:
                    sign = math.copysign(1, phi)
                else:
                    break
                drive = phi - sigma * sign
                # An event at the start is none: only one against the motion ends it.
                reversal.direction = -sign
                solution = solve_ivp(
                    lambda _, y: (y[1], (drive - beta * y[1]) / mu),
                    (begin, 1.0),
                    state,
                    method="DOP853",
                    rtol=TOLERANCE,
                    atol=TOLERANCE,
                    events=reversal,
                )
                state = solution.y[:, -1]
                if solution.status != 1:
                    break
                begin = solution.t[-1]
                state[1] = 0.0
            return state[0], state[1]

        return sample

    return start


def display(sample, sigma, v0, samples):
    """The class of one display, and the samples run."""
    windows = (0, WINDOW), (samples // 2, samples // 2 + WINDOW), (samples - WINDOW + 1, samples)
    peaks = [0.0, 0.0, 0.0]
    x, v, k = 0.0, v0, 0
    while True:
        speed = abs(v)
        for w, (first, last) in enumerate(windows):
            if first <= k <= last and speed > peaks[w]:
                peaks[w] = speed
        if not abs(x) <= DIVERGED_COUNTS:
            return "u", k
        phi = -(math.floor(x) + 0.5)
        if v == 0 and abs(phi) <= sigma:
            return "r", k
        if k == samples:
            break
        x, v = sample(phi)
        k += 1
    if peaks[2] > GROWTH * peaks[1] and peaks[2] > GROWTH * peaks[0]:
        return "u", k
    return ("r" if peaks[2] < CONVERGED_SPEED else "c"), k


def answer(line):
    word, setting, mu, v0, samples, *displays = line.split()
    if word != "run":
        raise ValueError("a request that is none")
    engine = {"mujoco": mujoco_engine, "scipy": scipy_engine}[setting](float(mu))
    v0, samples = float(v0), int(samples)
    classes, run = "", 0
    begin = time.process_time()
    for text in displays:
        beta, sigma = map(float, text.split(","))
        letter, count = display(engine(beta, sigma, v0), sigma, v0, samples)
        classes += letter
        run += count
    return f"done {time.process_time() - begin:.9f} {run} {classes}"


def main():
    # Ctrl-C and a parent that is gone end this quietly.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)
    print(f"ready MuJoCo {mujoco.__version__}, SciPy {scipy.__version__}, Python {sys.version.split()[0]}", flush=True)
    for line in sys.stdin:
        try:
            print(answer(line), flush=True)
        except Exception as error:  # Whatever it is, the other end tells it.
            print("error", type(error).__name__, " ".join(str(error).split()), flush=True)


main()
