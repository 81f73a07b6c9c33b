"""Exact two-stage Retrieve for batches of queries."""

from __future__ import annotations

import json
import os
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from . import _native
from ._artifact import Artifact
from ._errors import Re4Error

MODES = {"transit": 0, "transfer": 1}


class Retrieved(NamedTuple):
    """The answers to ``n`` queries. Where no frame has the mode of a query, numbers are -1 and distances NaN."""

    episode: npt.NDArray[np.int64]
    """Number of the demonstration, shape (n,)."""
    frame: npt.NDArray[np.int64]
    """Number of the frame in the demonstration, shape (n,)."""
    d_q: npt.NDArray[np.float64]
    """Distance over the full state, dimensionless, shape (n,)."""
    d_o: npt.NDArray[np.float64]
    """Distance over the object pose, dimensionless, shape (n,)."""


class Retriever:
    """The exact index over the frames of an ``index`` artifact.

    Retrieve has two stages: it finds the frame of every demonstration that is nearest in the full state (``d_q``), then the one
    of these frames that is nearest in the object pose (``d_o``). Only frames of the query's mode are considered. Ties go to the
    lowest demonstration, then to the lowest frame. The answers are those of a linear scan, bit for bit.

    Push-T: ``d_q`` is the Euclidean distance over (agent x, agent y, block x, block y, block angle), each divided by its range
    in the demonstrations; ``d_o`` over the last three. robosuite's tasks: a distance is the sum of a translation and a geodesic
    rotation angle, each divided by its scale, of the object pose (``d_o``) and of the end-effector pose in the object frame;
    ``d_q`` is the weighted sum of both.

    A retriever can be used by several threads at the same time.
    """

    def __init__(
        self,
        index: Artifact | str | os.PathLike[str],
        *,
        angle: str = "periodic",
        epsilon: float = 0.1,
        translation_scale: float = 0.1,
        rotation_scale: float = 1.0,
        object_weight: float = 1.0,
        eef_weight: float = 1.0,
        symmetry: dict[str, Any] | None = None,
        stage2: str = "object",
        threads: int = 0,
    ) -> None:
        """Builds the index, which takes milliseconds for 25,000 frames.

        Args:
            index: An ``index`` artifact, or its folder.
            angle: Push-T: ``periodic`` compares angles modulo 2 pi, ``raw`` as numbers in [0, 2 pi), as in the paper.
            epsilon: Push-T: stage 1 considers only frames whose ``d_o`` exceeds the smallest one of their demonstration by at
                most this; ``numpy.inf`` for all frames.
            translation_scale: robosuite: translation that contributes a distance of 1, in m.
            rotation_scale: robosuite: rotation that contributes a distance of 1, in rad.
            object_weight: robosuite: weight of the object pose in ``d_q``.
            eef_weight: robosuite: weight of the end-effector pose in the object frame in ``d_q``.
            symmetry: robosuite: rotations that leave the object's appearance unchanged, as in the pipeline setting
                ``rollout.symmetry``: ``{"kind": "full", "axis": [0, 0, 1]}``; None for an object without symmetry.
            stage2: robosuite: distance that ranks demonstrations: ``object``, as in the paper, or ``state``.
            threads: Number of threads; 0 for one per processor.

        Raises:
            Re4Error: If the artifact is no index, or a setting is invalid.
        """
        artifact = index if isinstance(index, Artifact) else Artifact(index)
        if artifact.kind != "index":
            raise Re4Error(
                f"cannot retrieve from {artifact.path}: it is an artifact of kind {artifact.kind}",
                "give the folder of an index artifact",
            )
        for name, value, known in [("angle", angle, ("periodic", "raw")), ("stage2", stage2, ("object", "state"))]:
            if value not in known:
                raise Re4Error(f"{name} is {value!r}", f"give one of {', '.join(known)}")
        if not epsilon >= 0:
            raise Re4Error(f"epsilon is {epsilon}", "give 0 or more")
        self.artifact = artifact
        self._setting = epsilon if "scales" in artifact else stage2 == "state"
        self._plane: _native.PlaneIndex | None = None
        self._space: _native.SpaceIndex | None = None
        if "scales" in artifact:
            self._plane = _native.PlaneIndex(artifact.path, angle == "periodic", threads)
        else:
            text = json.dumps(symmetry if symmetry is not None else {"kind": "none"})
            scales, weights = [translation_scale, rotation_scale], [object_weight, eef_weight]
            self._space = _native.SpaceIndex(artifact.path, scales, weights, text, threads)

    @property
    def planar(self) -> bool:
        """Whether the index is one of Push-T (SE(2)); otherwise it is one of a robosuite task (SE(3))."""
        return self._plane is not None

    def __len__(self) -> int:
        """Number of frames that can be retrieved."""
        index = self._plane or self._space
        return 0 if index is None else index.frames

    def retrieve(self, eef: npt.ArrayLike, object: npt.ArrayLike, mode: str | npt.ArrayLike = "transit") -> Retrieved:
        """Retrieves a frame for each of ``n`` queries, without the interpreter's lock. World frame.

        Args:
            eef: End effector. Push-T: position of the agent in px, shape (n, 2). robosuite: pose of the grip site, shape (n, 7):
                position in m, quaternion x, y, z, w.
            object: Object pose. Push-T: x, y in px and angle in rad, shape (n, 3). robosuite: as ``eef``, shape (n, 7).
            mode: ``transit`` or ``transfer``, for all queries or one for each; or codes, 0 for transit and 1 for transfer.

        Raises:
            Re4Error: If a coordinate is not finite, or a mode is unknown.
            ValueError: If shapes do not fit.
        """
        columns = (2, 3) if self.planar else (7, 7)
        eefs, objects = (_rows(array, width) for array, width in zip((eef, object), columns, strict=True))
        modes = _modes(mode, len(eefs))
        if not len(eefs) == len(objects) == len(modes):
            raise ValueError(f"there are {len(eefs)} end effectors, {len(objects)} objects and {len(modes)} modes")
        if self._plane is not None:
            return Retrieved(*self._plane.retrieve(modes, eefs, objects, float(self._setting)))
        assert self._space is not None
        return Retrieved(*self._space.retrieve(modes, eefs, objects, bool(self._setting)))


def _rows(array: npt.ArrayLike, width: int) -> npt.NDArray[np.float64]:
    rows = np.ascontiguousarray(array, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != width:
        raise ValueError(f"an array of shape {rows.shape} was given where (n, {width}) is needed")
    return rows


def _modes(mode: str | npt.ArrayLike, count: int) -> npt.NDArray[np.uint8]:
    given = np.asarray(mode)
    if given.dtype.kind in "UO":
        unknown = sorted({str(name) for name in given.flat} - MODES.keys())
        if unknown:
            raise Re4Error(f"there is no mode {unknown[0]!r}", "give transit or transfer")
        given = np.array([MODES[str(name)] for name in given.flat], dtype=np.uint8).reshape(given.shape)
    return np.ascontiguousarray(np.broadcast_to(given, (count,)) if given.ndim == 0 else given, dtype=np.uint8)
