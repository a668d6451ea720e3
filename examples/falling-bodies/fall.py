"""A pile of bodies falls, in MuJoCo: how long each step takes, and where everything is in the end.

fall.py STEPS SEED FOLDER writes FOLDER/steps.csv, a row a step, and FOLDER/state.txt, every position and velocity in full.
"""

import os
import random
import sys
import time

os.environ.setdefault("MUJOCO_GL", "disable")
sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "site"))

import mujoco  # noqa: E402: it is in `site`

BODIES = 20


def model(seed):
    """Boxes and balls above a floor, at places and angles that the seed draws."""
    drawn = random.Random(seed)
    bodies = ""
    for number in range(BODIES):
        x, y = drawn.uniform(-0.2, 0.2), drawn.uniform(-0.2, 0.2)
        euler = " ".join(f"{drawn.uniform(-180, 180):.6f}" for _ in range(3))
        shape = 'type="box" size="0.05 0.04 0.03"' if number % 2 else 'type="sphere" size="0.045"'
        bodies += f'<body pos="{x:.6f} {y:.6f} {0.2 + 0.12 * number:.6f}" euler="{euler}"><freejoint/><geom {shape}/></body>'
    return f'<mujoco><worldbody><geom type="plane" size="2 2 0.1"/>{bodies}</worldbody></mujoco>'


def main():
    steps, seed, folder = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
    pile = mujoco.MjModel.from_xml_string(model(seed))
    data = mujoco.MjData(pile)
    took = []
    for _ in range(steps):
        begun = time.perf_counter()
        mujoco.mj_step(pile, data)
        took.append(time.perf_counter() - begun)
    with open(os.path.join(folder, "steps.csv"), "w") as out:
        out.write("step_us\n")
        out.writelines(f"{1e6 * seconds:.3f}\n" for seconds in took)
    with open(os.path.join(folder, "state.txt"), "w") as out:
        # `hex` writes all bits of a number.
        out.writelines(f"{float(number).hex()}\n" for number in [*data.qpos, *data.qvel])


main()
