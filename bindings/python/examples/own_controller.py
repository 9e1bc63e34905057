"""A controller of your own in place of the built-in strategy: the law in polar coordinates of Aicardi et al. (1995).

    python own_controller.py
"""

import math

import cfmmr


def wrap(angle):
    return math.remainder(angle, 2 * math.pi)


class Polar:
    """Law in polar coordinates. The robot stops within 1 cm of the goal, or within 10 cm if the goal lies behind."""

    def begin(self):
        """Called at the start of each task."""
        self.arrived = False

    def step(self, input):
        """Velocity (m/s), curvature (1/m) and the end of the task, once an epoch of 10 ms."""
        x, y, heading = input.posture
        goal_x, goal_y, goal_heading = input.goal
        sin, cos = math.sin(heading), math.cos(heading)
        ahead = cos * (goal_x - x) + sin * (goal_y - y)
        aside = cos * (goal_y - y) - sin * (goal_x - x)
        distance = math.hypot(ahead, aside)
        self.arrived |= distance < 0.01 or (distance < 0.1 and ahead < 0)
        if self.arrived:
            return 0.0, 0.0, True
        bearing = math.atan2(aside, ahead)
        # Turn towards the goal, and away from its heading, so that the robot arrives along it.
        turn = 4 * bearing - 2 * wrap(goal_heading - heading - bearing)
        return min(0.2, 0.5 * distance + 0.02), max(-2.5, min(2.5, turn / distance)), False


if __name__ == "__main__":
    careful, trials = cfmmr.Scenario("careful"), cfmmr.trials(seed=31, count=10)
    for name, controller in (("built in", None), ("polar", Polar)):
        table = cfmmr.run_many(careful, trials, controller=controller)
        (row,) = cfmmr.summary(table)
        print(f"{name:8}  goal error {100 * row['e_m']:.1f} ± {100 * row['e_m_sd']:.1f} cm, {row['ends']}")
