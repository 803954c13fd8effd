"""The way of each robot to its start, around walls: a field of distances on a grid of 2 cm."""

import heapq

import numpy as np

CELL_M = 0.02


class Ways:
    """Ways on one ground; all points are those of the robots' commanded points."""

    def __init__(self, experiment):
        self.walls, self.half = np.array(experiment["walls"]).reshape(-1, 4), np.array(experiment["half_extent_m"])
        self.room = experiment["safety"]["walls_min_m"] + CELL_M / 2
        self.size = (2 * self.half / CELL_M).astype(int) + 1
        axes = [np.arange(count) * CELL_M - half for count, half in zip(self.size, self.half)]
        self.points = np.stack(np.meshgrid(*axes, indexing="ij"), 2)
        self.free = np.ones(tuple(self.size), bool)
        for low_x, low_y, high_x, high_y in self.walls:
            off = np.clip(self.points, (low_x, low_y), (high_x, high_y)) - self.points
            self.free &= np.hypot(off[..., 0], off[..., 1]) > self.room
        self.fields = {}

    def cell(self, point):
        return tuple(np.clip(np.rint((point + self.half) / CELL_M).astype(int), 0, self.size - 1))

    def straight(self, start, end):
        """Whether nothing is between two points."""
        steps = max(int(np.hypot(*(end - start)) / CELL_M), 1)
        return all(self.free[self.cell(start + (end - start) * k / steps)] for k in range(steps + 1))

    def field(self, goal):
        """Returns the length of the way from each cell to a goal [cells]."""
        key = self.cell(goal)
        if key not in self.fields:
            field = np.full(tuple(self.size), np.inf)
            field[key], heap = 0.0, [(0.0, key)]
            while heap:
                length, (x, y) = heapq.heappop(heap)
                if length > field[x, y]:
                    continue
                for dx, dy, more in [(1, 0, 1.0), (0, 1, 1.0), (1, 1, 2**0.5), (1, -1, 2**0.5)]:
                    for there in ((x + dx, y + dy), (x - dx, y - dy)):
                        inside = 0 <= there[0] < self.size[0] and 0 <= there[1] < self.size[1]
                        if inside and self.free[there] and length + more < field[there]:
                            field[there] = length + more
                            heapq.heappush(heap, (length + more, there))
            self.fields[key] = field
        return self.fields[key]

    def toward(self, position, goal):
        """Returns the direction of each robot's way to its goal, times its distance up to 1 m; of shape [robots, 2]."""
        result = goal - position
        for robot in range(len(position)):
            if len(self.walls) and not self.straight(position[robot], goal[robot]):
                field, (x, y) = self.field(goal[robot]), self.cell(position[robot])
                low = (max(x - 5, 0), max(y - 5, 0))
                part = field[low[0] : x + 6, low[1] : y + 6]
                at = np.unravel_index(np.argmin(part), part.shape)
                result[robot] = self.points[low[0] + at[0], low[1] + at[1]] - position[robot]
                result[robot] /= max(np.hypot(*result[robot]), 1e-9)
        return result
