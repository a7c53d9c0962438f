"""Eight moving assemblies that need no file: of stiff parts, thin shells, chains of small pieces on joints."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.assemblies.parts import Builder, Part, Points, bent, box, moved, revolved, ring, tube, turned

__all__ = ["ASSEMBLIES", "Assembly", "assembly"]

FRAMES = 24


@dataclass(frozen=True)
class Assembly:
    """One mesh of many components in motion.

    Attributes:
        name: what the reports call it.
        points: (F, V, 3) float32.
        faces: (N, 3) int32.
        part_count: components.
    """

    name: str
    points: NDArray[np.float32]
    faces: NDArray[np.int32]
    part_count: int


def assembly(name: str, frame_count: int = FRAMES) -> Assembly:
    """The assembly of that name in :data:`ASSEMBLIES`; the same bits every time."""
    builder = Builder(frame_count)
    ASSEMBLIES[name](builder, 2 * np.pi * np.arange(frame_count) / frame_count)
    return Assembly(name, np.concatenate(builder.points, axis=1), np.concatenate(builder.faces), len(builder.points))


def _ball(radius: float, rows: int, columns: int) -> Part:
    t = np.pi * (np.arange(rows) + 0.5) / rows
    return revolved(np.stack([radius * np.sin(t), -radius * np.cos(t)], axis=1), columns)


def _bolt(radius: float, height: float) -> Part:
    """A head with six sides on a shaft."""
    profile = [(0.4, -1.6), (0.4, -0.8), (0.4, 0.0), (1.0, 0.0), (1.0, 0.4), (0.9, 0.5)]
    return revolved(np.array(profile) * [radius, height], 12)


def _washer(inner: float, outer: float, height: float, columns: int) -> Part:
    return ring([(inner, 0.0), (outer, 0.0), (outer, height), (inner, height)], columns)


def _crane(builder: Builder, phase: Points) -> None:
    """Lattices of thin tubes, a rope and a hook: what turns, lifts and swings."""
    builder.add(box((2.0, 2.0, 0.4), (8, 8, 3)).at(0, 0, -0.2))
    corners = [(x, y) for x in (-0.3, 0.3) for y in (-0.3, 0.3)]
    rod = np.linspace(0, 1, 24)[:, None]
    for x, y in corners:
        builder.add(tube(np.array([x, y, 0.0]) + rod * [0, 0, 5.0], 0.05, 10))
    for level in range(10):
        side = np.array([[-0.3, 0.3], [0.3, 0.3], [0.3, -0.3], [-0.3, -0.3]])
        for i in range(4):
            a, b = np.array([*side[i], 0.5 * level]), np.array([*side[(i + 1) % 4], 0.5 * level + 0.5])
            builder.add(tube(a + rod[::3] * (b - a), 0.02, 8))
    slew = turned("z", 0.6 * np.sin(phase))
    builder.add(box((0.9, 0.9, 0.8), (8, 8, 7)).at(0, 0, 5.4), slew)
    builder.add(box((0.7, 0.9, 0.6), (6, 8, 5)).at(-1.6, 0, 5.9), slew)
    boom = slew @ bent("y", 0.15 * np.sin(2 * phase), (0, 0, 5.8))
    for y in (-0.25, 0.25):
        for z in (5.8, 6.2):
            builder.add(tube(np.array([-1.8, y, z]) + rod * [6.0, 0, 0], 0.04, 10), boom)
    for i in range(24):
        a, b = np.array([-1.8 + 0.25 * i, 0.25, 5.8]), np.array([-1.8 + 0.25 * i + 0.25, -0.25, 6.2])
        builder.add(tube(a + rod[::3] * (b - a), 0.015, 8), boom)
    hang = boom @ bent("y", -0.15 * np.sin(2 * phase) + 0.2 * np.sin(phase), (4.0, 0, 5.8))
    builder.add(tube(np.array([4.0, 0, 3.0]) + rod * [0, 0, 2.8], 0.012, 8), hang)
    bow = np.linspace(-0.5 * np.pi, np.pi, 30)
    hook = np.stack([4.0 + 0.2 * np.cos(bow), 0 * bow, 2.8 + 0.2 * np.sin(bow)], axis=1)
    builder.add(tube(hook, 0.05 * np.sin(np.linspace(0.15, np.pi - 0.15, 30)) ** 0.5, 12), hang)
    builder.add(_ball(0.12, 10, 16).at(4.0, 0, 3.05), hang)


def _plate(length: float, width: float, thickness: float, bulge: float) -> Part:
    """A thin shell that is bent about its length (z)."""
    sheet = box((width, thickness, length), (8, 1, 8))
    return sheet.mapped(lambda p: np.stack([p[:, 0], p[:, 1] + bulge * np.cos(2 * p[:, 0] / width), p[:, 2]], axis=1))


def _limb(builder: Builder, motion: Points, top: tuple[float, float, float], length: float, girth: float) -> None:
    """A capsule downwards, plates over it on all sides, bolts on them, a ring at its end: 24 pieces."""
    x, y, z = top
    builder.add(_ball(1.0, 10, 12).scaled(0.7 * girth, 0.7 * girth, 0.5 * length).at(x, y, z - 0.5 * length), motion)
    for side in range(4):
        for row in range(2):
            angle = 0.5 * np.pi * side + 0.3 * row
            plate = _plate(0.55 * length, 1.3 * girth, 0.06 * girth, 0.3 * girth).at(0, 0.75 * girth, 0)
            builder.add(plate.turned("z", angle).at(x, y, z - (0.25 + 0.45 * row) * length), motion)
            bolt = _bolt(0.08 * girth, 0.1 * girth).turned("x", -0.5 * np.pi).at(0, 1.12 * girth, 0)
            builder.add(bolt.turned("z", angle).at(x, y, z - (0.25 + 0.45 * row) * length), motion)
    for i in range(6):
        band = _washer(0.6 * girth, 0.72 * girth, 0.05 * length, 16)
        builder.add(band.at(x, y, z - (0.08 + 0.16 * i) * length), motion)
    builder.add(_washer(0.7 * girth, 0.95 * girth, 0.12 * length, 20).at(x, y, z - length), motion)


def _fingers(builder: Builder, motion: Points, wrist: tuple[float, float, float], curl: Points, size: float) -> None:
    """Five fingers of three pieces and a nail each."""
    x, y, z = wrist
    for finger in range(5):
        joint, at = motion, np.array([x + size * (0.4 * finger - 0.8), y, z])
        for piece in range(3):
            joint = joint @ bent("x", curl * (0.6 + 0.1 * finger), tuple(at))
            length = size * (0.7 - 0.12 * piece) * (0.7 if finger in (0, 4) else 1.0)
            bone = _ball(1.0, 8, 10).scaled(0.17 * size, 0.17 * size, 0.6 * length)
            builder.add(bone.at(*(at - [0, 0, 0.5 * length])), joint)
            at = at - [0, 0, length]
        nail = box((0.2 * size, 0.04 * size, 0.2 * size), (3, 1, 3))
        builder.add(nail.at(at[0], at[1] + 0.16 * size, at[2] + 0.15 * size), joint)


def _figure(builder: Builder, phase: Points) -> None:
    """A walking figure in armour."""
    hip = turned("z", 0.1 * np.sin(phase))
    chest = hip @ bent("x", 0.08 * np.sin(2 * phase), (0, 0, 1.1))
    builder.add(box((0.5, 0.3, 0.3), (8, 5, 5)).at(0, 0, 1.0), hip)
    builder.add(box((0.6, 0.35, 0.6), (10, 6, 10)).at(0, 0, 1.45), chest)
    for i in range(12):
        angle = 2 * np.pi * i / 12
        canister = revolved([(0.02, 0), (0.035, 0.02), (0.035, 0.12), (0.02, 0.14)], 12)
        builder.add(canister.at(0.3 * np.cos(angle), 0.2 * np.sin(angle), 1.05), hip)
    for side in (-1, 1):
        for row in range(4):
            plate = _plate(0.16, 0.28, 0.015, 0.05).at(0.15 * side, 0.19, 1.25 + 0.14 * row)
            builder.add(plate, chest)
            builder.add(plate.mapped(lambda p: p * [-1, -1, 1]), chest)
    head = chest @ bent("z", 0.3 * np.sin(phase), (0, 0, 1.8))
    builder.add(_ball(0.15, 16, 24).scaled(1, 1.1, 1.3).at(0, 0, 1.98), head)
    builder.add(box((0.26, 0.03, 0.03), (12, 2, 2)).at(0, 0.17, 2.04), head)
    for x in (-0.06, 0.06):
        builder.add(_ball(0.025, 8, 12).at(x, 0.155, 2.0), head)
        builder.add(_washer(0.03, 0.04, 0.02, 16).turned("x", -0.5 * np.pi).at(x, 0.15, 2.0), head)
    for side in (-1, 1):
        swing = 0.5 * side * np.sin(phase)
        thigh = hip @ bent("x", swing, (0.15 * side, 0, 0.95))
        shin = thigh @ bent("x", -0.4 * (1 - np.cos(phase + side)), (0.15 * side, 0, 0.55))
        _limb(builder, thigh, (0.15 * side, 0, 0.95), 0.4, 0.1)
        _limb(builder, shin, (0.15 * side, 0, 0.52), 0.4, 0.08)
        foot = shin @ bent("x", -0.3 * np.sin(phase), (0.15 * side, 0, 0.1))
        builder.add(box((0.12, 0.3, 0.08), (5, 10, 4)).at(0.15 * side, 0.07, 0.04), foot)
        for toe in range(5):
            builder.add(_ball(0.016, 6, 8).scaled(1, 2, 1).at(0.15 * side + 0.025 * (toe - 2), 0.24, 0.03), foot)
        arm = chest @ bent("x", -swing, (0.4 * side, 0, 1.7))
        elbow = arm @ bent("x", 0.4 + 0.3 * np.sin(phase), (0.4 * side, 0, 1.35))
        _limb(builder, arm, (0.4 * side, 0, 1.7), 0.34, 0.08)
        _limb(builder, elbow, (0.4 * side, 0, 1.33), 0.3, 0.07)
        _fingers(builder, elbow, (0.4 * side, 0, 0.98), 0.4 + 0.3 * np.sin(phase), 0.07)


def _bolted_plate(builder: Builder, phase: Points) -> None:
    """A plate that swings like a door, with washers and bolts in rows."""
    swing = turned("z", 0.5 * np.sin(phase))
    builder.add(box((4.0, 0.2, 4.0), (20, 1, 20)).at(2.0, 0, 0), swing)
    for i in range(7):
        for j in range(7):
            loose = swing @ bent("y", (0.5 + 0.1 * i) * np.sin(phase + j), (0.5 + 0.5 * i, 0, 0.5 * j - 1.5))
            at = (0.5 + 0.5 * i, 0.1, 0.5 * j - 1.5)
            builder.add(_washer(0.07, 0.16, 0.03, 20).turned("x", -0.5 * np.pi).at(*at), swing)
            builder.add(_bolt(0.11, 0.12).turned("x", -0.5 * np.pi).at(at[0], at[1] + 0.03, at[2]), loose)


def _shells(builder: Builder, phase: Points) -> None:
    """Bumpy shells in each other that breathe in turn."""
    for layer in range(7):
        ball = _ball(1.0, 26, 40)
        x, y, z = ball.points.T
        bump = 1 + 0.05 * np.sin(5 * x + layer) * np.cos(4 * y) * np.sin(3 * z)
        breath = (0.5 + 0.12 * layer) * (1 + 0.04 * np.sin(phase + 0.8 * layer))
        squeeze = 1 + 0.1 * np.sin(phase)[:, None] * z
        points = breath[:, None, None] * (ball.points * bump[:, None])[None] * squeeze[..., None]
        builder.add_frames(points, ball.faces)


def _chain(builder: Builder, phase: Points) -> None:
    """Links that hang on each other and swing."""
    angle = 2 * np.pi * np.arange(10) / 10
    section = np.stack([0.3 + 0.09 * np.cos(angle), 0.09 * np.sin(angle)], axis=1)
    joint: Points = np.eye(4)
    for i in range(40):
        joint = joint @ bent("x", 0.08 * np.sin(phase + 0.3 * i), (0, 0, -0.8 * i))
        link = ring(section, 24).turned("x", 0.5 * np.pi)
        link = link.mapped(lambda p: p + np.array([0, 0, 0.25]) * np.sign(np.round(p[:, 2:], 6)))
        builder.add((link.turned("z", 0.5 * np.pi) if i % 2 else link).at(0, 0, -0.8 * i - 0.4), joint)


def _leaf(points: Points) -> Points:
    """A sheet along y, narrow at both ends."""
    width = 0.3 + np.sin(0.55 * np.pi * points[:, 1])
    return np.stack([width * points[:, 0], points[:, 1], points[:, 2]], axis=1)


def _insect(builder: Builder, phase: Points) -> None:
    """Thin jointed legs, feelers and wings on a body of three pieces."""
    for x, size in ((-1.1, (1.0, 0.45, 0.4)), (0.0, (0.5, 0.4, 0.35)), (0.7, (0.3, 0.3, 0.25))):
        builder.add(_ball(1.0, 20, 28).turned("y", 0.5 * np.pi).scaled(*size).at(x, 0, 0))
    rod = np.linspace(0, 1, 14)[:, None]
    for side in (-1, 1):
        for leg in range(3):
            step = 0.35 * np.sin(phase + np.pi * (leg + (side > 0)))
            joint, at = bent("z", step, (0.25 * (leg - 1), 0.3 * side, 0)), np.array([0.25 * (leg - 1), 0.3 * side, 0])
            thickness = 0.07
            for piece, drop in enumerate((0.5, 0.1, -0.9, -0.3)):
                end = at + np.array([0.15 * (leg - 1), 0.6 * side * (1.0 - 0.2 * piece), drop * (0.8 - 0.1 * piece)])
                joint = joint @ bent("x", 0.15 * side * np.sin(phase + piece), tuple(at))
                taper = thickness * (1 - 0.35 * rod[:, 0])
                builder.add(tube(at + rod * (end - at), taper, 10), joint)
                at, thickness = end, 0.65 * thickness
            for claw in (-1, 1):
                tip = at + np.array([0.08 * claw, 0.06 * side, -0.05])
                builder.add(tube(at + rod[::2] * (tip - at), 0.015 * (1.05 - rod[::2, 0]), 6), joint)
        feel = np.stack([0.95 + rod[:, 0], 0.1 * side + 0.4 * side * rod[:, 0], 0.4 * rod[:, 0] ** 2], axis=1)
        builder.add(tube(feel, 0.02 * (1.2 - rod[:, 0]), 8), bent("y", 0.2 * np.sin(2 * phase), (0.95, 0, 0)))
        for pair in range(2):
            sheet = box((0.7, 1.6, 0.012), (14, 30, 1)).at(0, 0.8, 0)
            leaf = sheet.mapped(_leaf).turned("z", 0.5 * pair if side > 0 else np.pi - 0.5 * pair)
            flap = bent("x", 0.7 * side * np.sin(3 * phase + pair), (0, 0.1 * side, 0.3))
            builder.add(leaf.at(-0.2 * pair, 0.1 * side, 0.3 + 0.03 * pair), flap)


def _hand(builder: Builder, phase: Points) -> None:
    """A mechanical hand: rings around phalanges, tendons, nails."""
    builder.add(box((1.6, 0.4, 1.6), (14, 4, 14)).at(0, 0, 0.8))
    rod = np.linspace(0, 1, 20)[:, None]
    for finger in range(5):
        at = np.array([0.38 * (finger - 2), 0.0, 1.6 if finger else 0.9])
        joint: Points = np.eye(4)
        for piece in range(3):
            curl = 0.35 * (1 - np.cos(phase + 0.5 * finger))
            joint = joint @ bent("x", -curl, tuple(at))
            length = (0.62, 0.45, 0.36)[piece] * (1.0 if finger not in (0, 4) else 0.8)
            bone = _ball(1.0, 12, 16).scaled(0.15 - 0.02 * piece, 0.15 - 0.02 * piece, 0.55 * length)
            builder.add(bone.at(at[0], at[1], at[2] + 0.5 * length), joint)
            for k in range(2):
                band = _washer(0.15 - 0.02 * piece, 0.18 - 0.02 * piece, 0.06, 20)
                builder.add(band.at(at[0], at[1], at[2] + (0.2 + 0.5 * k) * length), joint)
            pin = tube(at + (rod[::2] - 0.5) * [0.4, 0, 0], 0.03, 8)
            builder.add(pin, joint)
            tendon = tube(at + rod * [0, 0, length] + [0, 0.2, 0], 0.012, 6)
            builder.add(tendon, joint)
            at = at + np.array([0, 0, length])
        builder.add(box((0.14, 0.03, 0.16), (4, 1, 4)).at(at[0], at[1] - 0.12, at[2] - 0.12), joint)


def _track(builder: Builder, phase: Points) -> None:
    """Pads with teeth that run around wheels with spokes."""
    straight, radius, count = 4.0, 0.8, 48
    length = 2 * straight + 2 * np.pi * radius
    pad = box((0.24, 1.0, 0.08), (4, 8, 2))
    tooth = box((0.08, 0.1, 0.16), (2, 2, 3)).at(0, 0, -0.12)
    for i in range(count):
        s = (length * i / count + length * phase / (2 * np.pi)) % length
        motion = np.stack([_stadium(float(value), straight, radius) for value in s])
        builder.add(pad, motion)
        for y in (-0.3, 0.3):
            builder.add(tooth.at(0, y, 0), motion)
    rod = np.linspace(0, 1, 10)[:, None]
    for wheel in range(5):
        x = straight * (wheel / 4 - 0.5)
        spin = moved(x, 0, 0) @ turned("y", -phase * (2 if wheel % 4 else 1))
        builder.add(ring([(0.55, -0.2), (0.7, -0.2), (0.7, 0.2), (0.55, 0.2)], 40).turned("x", 0.5 * np.pi), spin)
        builder.add(revolved([(0.12, -0.3), (0.15, -0.2), (0.15, 0.2), (0.12, 0.3)], 16).turned("x", 0.5 * np.pi), spin)
        for spoke in range(6):
            angle = np.pi * spoke / 3
            end = 0.6 * np.array([np.cos(angle), 0, np.sin(angle)])
            builder.add(tube(rod * end, 0.04, 8), spin)


def _stadium(s: float, straight: float, radius: float) -> Points:
    """(4, 4) place of a pad after so much of the way around."""
    arc = np.pi * radius
    if s < straight:
        return moved(s - straight / 2, 0, radius)
    if s < straight + arc:
        return moved(straight / 2, 0, 0) @ turned("y", (s - straight) / radius) @ moved(0, 0, radius)
    if s < 2 * straight + arc:
        return moved(straight / 2 - (s - straight - arc), 0, 0) @ turned("y", np.pi) @ moved(0, 0, radius)
    turn = np.pi + (s - 2 * straight - arc) / radius
    return moved(-straight / 2, 0, 0) @ turned("y", turn) @ moved(0, 0, radius)


ASSEMBLIES: dict[str, Callable[[Builder, Points], None]] = {
    "crane": _crane,
    "figure": _figure,
    "bolted_plate": _bolted_plate,
    "shells": _shells,
    "chain": _chain,
    "insect": _insect,
    "hand": _hand,
    "track": _track,
}
