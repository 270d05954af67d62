"""Draws the arena from above with MuJoCo, with the robot's trail and sensor signals."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from ...models import Dimensions, centre_nose, robot_qpos
from ...tasks.rules import RANGEFINDERS
from ...tasks.spot_finding import SpotFindingRules
from ...tasks.suite import TASKS
from .offscreen import Canvas
from .replay import Moment

WIDTH, HEIGHT = 720, 496  # [pixels]

_NOSES = {"nose": ("nose",), "noses": ("left_nose", "right_nose")}  # sites by signal name

Colour = tuple[float, float, float]
BLUE, GREY, AMBER = (0.13, 0.42, 0.66), (0.46, 0.53, 0.62), (0.98, 0.65, 0.15)
RED, GREEN, _MOSS = (0.89, 0.20, 0.16), (0.16, 0.66, 0.27), (0.04, 0.34, 0.12)
_REACH, _SLICES = 0.24, 12  # radius of a nose's sector in [m], number of its triangles
JUMP = 0.1  # [m]; a robot that moves more in a control step was placed anew
_IN_THE_SPOT = 0.1  # [m]; a robot in the spot is nearer than this to the spot's centre


class Trail(NamedTuple):
    """Earlier positions of the robot, the latest last."""

    points: np.ndarray  # x, y in [m], shape (n, 2)
    events: np.ndarray  # whether the event happened at each position, shape (n,)
    ages: np.ndarray  # in [0, 1], shape (n,): 0 is now, at 1 a position disappears


class Scene:
    """Draws the arena of a task, with the robot's trail and sensor signals."""

    def __init__(self, task: str, dimensions: Dimensions | None = None) -> None:
        """Compiles the arena; `dimensions` give the nose's place. InputError without EGL."""
        spec = TASKS[task].spec()
        if dimensions and dimensions.nose == 0:
            centre_nose(spec)
        # Without a graphics card shadows would take more than half of the time.
        for light in spec.lights:
            light.castshadow = False
        spec.visual.headlight.ambient = [0.46] * 3
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._rules = TASKS[task].rules.of(self._model)
        self._canvas = Canvas(self._model, "overhead", WIDTH, HEIGHT)
        self.renderer = self._canvas.renderer

    def draw(self, shot: Moment, trail: Trail) -> np.ndarray:
        """Returns the image, uint8, shape (HEIGHT, WIDTH, 3); the next call overwrites it."""
        self._data.qpos[:] = robot_qpos(shot.pose)
        self._data.mocap_pos[0, :2] = shot.spot
        mujoco.mj_forward(self._model, self._data)
        self._canvas.look(self._data)
        self._trail(trail)
        if isinstance(self._rules, SpotFindingRules):
            self._smells(shot, self._rules.nose.frustum)
        if "distances" in shot.signals:
            self._distances(shot)
        return self._canvas.pixels()

    def close(self) -> None:
        """Frees the resources of OpenGL."""
        self._canvas.close()

    def _trail(self, trail: Trail) -> None:
        event = _MOSS if isinstance(self._rules, SpotFindingRules) else RED
        points = np.column_stack([trail.points, np.full(len(trail.points), 0.0015)])
        jumps = np.hypot(*np.diff(trail.points, axis=0).T) > JUMP
        for k in np.flatnonzero(~jumps):
            colour = event if trail.events[k + 1] else BLUE
            self._line(points[k], points[k + 1], 4, colour, 0.85 * (1 - trail.ages[k]))

    def _distances(self, shot: Moment) -> None:
        if shot.contact:
            self._ring(shot.pose, 0.034, 0.031, RED)
        # Measured in the pose that is drawn, which may lie between two control steps.
        distances = self._data.sensordata[self._rules.layout.distances]
        for name, distance, signal in zip(
            RANGEFINDERS, distances, shot.signals["distances"], strict=True
        ):
            if distance < 0:
                continue
            site = self._data.site(name)
            end = site.xpos + distance * site.xmat.reshape(3, 3)[:, 2]
            colour = heat(signal, RED)
            self._line(site.xpos, end, 3, colour, 0.55 + 0.45 * signal)
            self._add(mujoco.mjtGeom.mjGEOM_SPHERE, [0.004] * 3, end, np.eye(3), colour, 1)

    def _smells(self, shot: Moment, frustum: float) -> None:
        # In some worlds the event is another one than being in the spot.
        if shot.event and np.hypot(*(shot.spot - shot.pose[:2])) < _IN_THE_SPOT:
            self._ring(shot.spot, 0.062, 0.002, GREEN)
        for name in _NOSES.keys() & shot.signals.keys():
            for side, signal in enumerate(shot.signals[name]):
                height = 0.002 + 0.0001 * side  # two sectors must not share a plane
                nose = self._data.site(_NOSES[name][side])
                ahead = np.arctan2(nose.xmat[3], nose.xmat[0]) + shot.nose
                cosine, sine = np.cos(shot.nose), np.sin(shot.nose)
                turn = np.array([[cosine, -sine], [sine, cosine]])
                place = shot.pose[:2] + turn @ (nose.xpos[:2] - shot.pose[:2])
                self._smell(np.array([*place, height]), ahead, float(signal), frustum)

    def _smell(self, nose: np.ndarray, ahead: float, signal: float, frustum: float) -> None:
        angles = ahead + np.linspace(-frustum / 2, frustum / 2, _SLICES + 1)
        rays = np.column_stack([np.cos(angles), np.sin(angles)])
        half = np.array([self._model.geom("east").pos[0], self._model.geom("north").pos[1]])
        with np.errstate(divide="ignore"):
            to_wall = ((np.copysign(half, rays) - nose[:2]) / rays).min(axis=1)
        # Overlapping sectors make the colour denser near the nose.
        for layer, share in enumerate((1.0, 0.75, 0.5, 0.25)):
            corners = np.clip(to_wall, 0, share * _REACH)[:, None] * rays
            base = nose + [0, 0, 0.0002 * layer]
            for first, second in zip(corners[:-1], corners[1:], strict=True):
                # MuJoCo's triangle (0, 0), (1, 0), (0, 1), whose axes are the sector's edges.
                frame = np.eye(3)
                frame[:2, 0], frame[:2, 1] = first, second
                triangle = mujoco.mjtGeom.mjGEOM_TRIANGLE
                alpha = 0.14 + 0.16 * signal
                self._add(triangle, [1, 1, 0], base, frame, heat(signal, GREEN), alpha)

    def _ring(self, centre: np.ndarray, radius: float, height: float, colour: Colour) -> None:
        angles = np.linspace(0, 2 * np.pi, 41)
        x, y = centre[0] + radius * np.cos(angles), centre[1] + radius * np.sin(angles)
        points = np.column_stack([x, y, np.full(len(angles), height)])
        for first, second in zip(points[:-1], points[1:], strict=True):
            self._line(first, second, 5, colour, 1)

    def _line(
        self, start: np.ndarray, end: np.ndarray, pixels: float, colour: Colour, alpha: float
    ) -> None:
        kind = mujoco.mjtGeom.mjGEOM_LINE
        if (geom := self._add(kind, [0, 0, 0], start, np.eye(3), colour, alpha)) is not None:
            mujoco.mjv_connector(geom, kind.value, pixels, start, end)

    def _add(
        self,
        kind: mujoco.mjtGeom,
        size: list[float],
        position: np.ndarray,
        frame: np.ndarray,
        colour: Colour,
        alpha: float,
    ) -> mujoco.MjvGeom | None:
        """Adds a geom to the scene and returns it; None if the scene is full."""
        scene = self._canvas.scene
        if scene.ngeom >= scene.maxgeom:
            return None
        geom = scene.geoms[scene.ngeom]
        scene.ngeom += 1
        rgba = np.array([*colour, alpha], dtype=np.float32)
        mujoco.mjv_initGeom(geom, kind.value, np.array(size, float), position, frame.ravel(), rgba)
        geom.category = mujoco.mjtCatBit.mjCAT_DECOR.value  # no shadow
        geom.emission, geom.specular = 0.15, 0.0
        return geom


def heat(signal: float, hot: Colour) -> Colour:
    """Returns the colour of a signal in [0, 1]: grey at 0, amber at 0.5, `hot` at 1."""
    stops = np.array([GREY, AMBER, hot])
    red, green, blue = (np.interp(signal, [0, 0.5, 1], stops[:, k]) for k in range(3))
    return float(red), float(green), float(blue)
