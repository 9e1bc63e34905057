"""An estimator of your own in place of the joint filter: each axle moves by its odometry, the beam is blended in.

    python own_estimator.py
"""

import math

import numpy as np

import cfmmr

GAIN = 0.05
"""Share of the difference between beam and odometry that is corrected in an epoch."""
GROWTH = 0.01
"""Growth of the standard deviations with the distance: m/m, m/m, rad/m."""


def compose(at, motion):
    """Posture after a motion in its own coordinates."""
    x, y, heading = at
    sin, cos = math.sin(heading), math.cos(heading)
    return x + cos * motion[0] - sin * motion[1], y + sin * motion[0] + cos * motion[1], heading + motion[2]


def relative(front, rear):
    """Posture of the front axle in the coordinates of the rear axle."""
    dx, dy = front[0] - rear[0], front[1] - rear[1]
    sin, cos = math.sin(rear[2]), math.cos(rear[2])
    return cos * dx + sin * dy, cos * dy - sin * dx, front[2] - rear[2]


def midpoint(front, rear):
    """Midpoint of the axles, heading from the rear to the front axle."""
    dx, dy = front[0] - rear[0], front[1] - rear[1]
    return (front[0] + rear[0]) / 2, (front[1] + rear[1]) / 2, math.atan2(dy, dx)


def shifted(at, along, off, share):
    """Posture shifted by a share of a difference along the axes of the heading `along`."""
    x, y, _ = compose((at[0], at[1], along), [share * value for value in off])
    return x, y, at[2] + share * off[2]


class Blend:
    """Complementary blend of odometry and beam."""

    def start(self, center, relative_posture):
        """Places the axles; called at rest, before the first step. Each argument: posture and covariance."""
        posture, covariance = center
        off, _ = relative_posture
        # Heading of the chord between the axles in the coordinates of the rear axle.
        chord = math.atan2(off[1], off[0])
        half, heading = math.hypot(off[0], off[1]) / 2, posture[2] - chord
        x, y = half * math.cos(posture[2]), half * math.sin(posture[2])
        self.rear = posture[0] - x, posture[1] - y, heading
        self.front = posture[0] + x, posture[1] + y, heading + off[2]
        self.placed = np.sqrt(np.diag(covariance))
        self.distance = 0.0

    def step(self, input):
        """Postures and covariances of front axle, rear axle and midpoint, once an epoch of 10 ms."""
        if input.front is not None:
            self.front = compose(self.front, input.front[0])
        if input.rear is not None:
            self.rear = compose(self.rear, input.rear[0])
        # With one message missing the axles are of two instants: the beam waits for the next epoch.
        if input.front is not None and input.rear is not None:
            self.distance += abs(input.front[0][0] + input.rear[0][0]) / 2
            if input.beam is not None:
                # Each axle takes half of the correction.
                off = [beam - odometry for beam, odometry in zip(input.beam[0], relative(self.front, self.rear))]
                along = self.rear[2]
                self.front = shifted(self.front, along, off, GAIN / 2)
                self.rear = shifted(self.rear, along, off, -GAIN / 2)
        covariance = np.diag((self.placed + GROWTH * self.distance) ** 2)
        postures = np.array([self.front, self.rear, midpoint(self.front, self.rear)])
        return postures, np.array([covariance, covariance, covariance])


if __name__ == "__main__":
    careful, trials = cfmmr.Scenario("careful"), cfmmr.trials(seed=31, count=10)
    for name, estimator in (("joint filter", None), ("blend", Blend)):
        table = cfmmr.run_many(careful, trials, estimator=estimator)
        (row,) = cfmmr.summary(table)
        print(f"{name:12}  goal error {100 * row['e_m']:.1f} ± {100 * row['e_m_sd']:.1f} cm, {row['ends']}")
