"""What stands between policy and wheels: a safety filter, a way out of deadlocks, and two wheels for one velocity.

The filter is Murmurate's own (docs/safety.md), for robots that follow their commands at once: each other robot, wall
and side of the ground bounds one component of the velocity, and the command is the velocity nearest to the wanted one
within all bounds. It is not the barrier certificate of `rps.utilities`, whose solver it does without.
"""

import numpy as np

GAIN_PER_S = 3.0  # speed toward a bound for each metre of room [1/s]; two robots use half of it each


def nearest(wanted, limits):
    """Returns the velocity nearest to `wanted` with along . velocity <= most for all (along, most); zero if none is."""
    result = wanted
    for at, (along, most) in enumerate(limits):
        if along @ result <= most + 1e-9:
            continue
        foot, line = along * most, np.array([-along[1], along[0]])
        low, high = -np.inf, np.inf
        for other, bound in limits[:at]:
            across, room = other @ line, bound - other @ foot
            if abs(across) < 1e-9:
                if room < -1e-9:
                    return np.zeros(2)
            elif across > 0:
                high = min(high, room / across)
            else:
                low = max(low, room / across)
        if low > high + 1e-9:
            return np.zeros(2)
        result = foot + line * np.clip(wanted @ line, low, max(low, high))
    return result


class Guard:
    """Guard of all robots, which stand in rows: positions and velocities are those of the commanded points."""

    def __init__(self, experiment):
        self.safety, self.drive = experiment["safety"], experiment["drive"]
        self.walls, self.half = np.array(experiment["walls"]).reshape(-1, 4), np.array(experiment["half_extent_m"])
        robots = experiment["robots"]
        self.held, self.left = np.zeros(robots), np.zeros(robots, bool)
        self.close, self.gives = np.zeros(robots), [None] * robots

    def bounds(self, position, robot):
        """Returns the bounds of the velocity of a robot."""
        at, limits = position[robot], []
        for other in range(len(position)):
            offset = position[other] - at
            apart = np.hypot(*offset)
            if other != robot and apart < 1.0:
                along = offset / max(apart, 1e-9)
                limits.append((along, GAIN_PER_S / 2 * max(apart - self.safety["distance_min_m"], 0.0)))
        for low_x, low_y, high_x, high_y in self.walls:
            offset = np.clip(at, (low_x, low_y), (high_x, high_y)) - at
            apart = np.hypot(*offset)
            if 1e-9 < apart < 1.0:
                limits.append((offset / apart, GAIN_PER_S * max(apart - self.safety["walls_min_m"], 0.0)))
        for axis in (0, 1):
            for side in (-1.0, 1.0):
                along = np.zeros(2)
                along[axis] = side
                limits.append((along, GAIN_PER_S * max(self.half[axis] - side * at[axis], 0.0)))
        return limits

    def apply(self, position, velocity, wanted, period):
        """Returns the velocity of each robot's point [m/s] in place of the wanted one, for a period [s]."""
        speed = np.hypot(wanted[:, 0], wanted[:, 1])[:, None]
        wanted = wanted * np.minimum(1.0, self.drive["speed_m_s"] / np.maximum(speed, 1e-9))
        results = np.zeros_like(wanted)
        for robot in range(len(wanted)):
            aim, limits = wanted[robot], self.bounds(position, robot)
            results[robot] = nearest(self.turned(robot, aim), limits)
            self.remember(robot, aim, results[robot], self.stands_close(robot, position, velocity), period)
        return results

    def turned(self, robot, aim):
        """Returns what a robot aims at: turned aside the longer it was held, or away from one that it lets pass."""
        if self.gives[robot] is not None:
            return self.gives[robot] * self.drive["speed_m_s"]
        angle = min(0.5 * self.held[robot], 1.57) * (1 if self.left[robot] else -1)
        return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) @ aim

    def stands_close(self, robot, position, velocity):
        """Returns the direction away from the nearest robot that stands close by; `None` without one."""
        away = position[robot] - position
        apart = np.hypot(away[:, 0], away[:, 1])
        apart[robot] = np.inf
        apart[np.hypot(velocity[:, 0], velocity[:, 1]) > 0.05] = np.inf
        other = int(np.argmin(apart))
        return away[other] / apart[other] if 0 < apart[other] < self.safety["distance_min_m"] + 0.09 else None

    def remember(self, robot, aim, result, away, period):
        """Counts for how long the bounds have held a robot, and for how long one has stood before it at its goal."""
        wants = np.hypot(*aim)
        self.close[robot] += period
        if self.gives[robot] is not None and self.close[robot] < 1.5:
            return
        if self.gives[robot] is None and away is not None and wants < 0.05:
            if self.close[robot] > 0.5:
                self.gives[robot], self.close[robot] = away, 0.0
                return
        else:
            self.gives[robot], self.close[robot] = None, 0.0
        if wants < 0.05 or np.hypot(*result) > 0.2 * wants:
            self.held[robot] = max(self.held[robot] - 2 * period, 0.0)
            return
        if self.held[robot] <= 0:
            self.left[robot] = aim[0] * result[1] - aim[1] * result[0] > 0.05 * wants**2
        self.held[robot] += period
        if self.held[robot] > 8.0:
            self.held[robot], self.left[robot] = period, not self.left[robot]

    def wheels(self, velocity, heading):
        """Returns forward speeds [m/s] and yaw rates [rad/s], as rows, that move the points at these velocities.

        The point is `point_ahead_m` before the axle. What is beyond a limit is reduced alike, so that a robot stays
        on its curve. Limits are a hair below those of the actuators, whose validator counts rounding errors.
        """
        ahead, drive = np.stack([np.cos(heading), np.sin(heading)], 1), self.drive
        forward = (velocity * ahead).sum(1)
        turn = (ahead[:, 0] * velocity[:, 1] - ahead[:, 1] * velocity[:, 0]) / drive["point_ahead_m"]
        wheel = np.abs(forward) + np.abs(turn) * drive["track_m"] / 2
        over = [np.abs(forward) / drive["speed_m_s"], np.abs(turn) / drive["yaw_rate_rad_s"]]
        over.append(wheel / drive["wheel_speed_m_s"])
        share = 1.0 / np.maximum(np.max(over, 0), 1.0)
        return np.stack([forward * share, turn * share])
