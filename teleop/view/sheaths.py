"""The known sheaths: shapes, joints and places in the scene."""

from estimator.array_types import Array
from teleop.messages.messages import PROFILE_POINTS
from teleop.view.band import compute_friction_profile
from teleop.view.batch import Rows
from teleop.view.config import ViewConfig
from teleop.view.stage import Shape, Stage, build_stage


class Sheaths:
    """From Sheath messages, once a second."""

    def __init__(self, config: ViewConfig) -> None:
        self._config = config
        self.shapes: dict[int, Shape] = {}
        self.friction: dict[int, Array] = {}  # tendon -> k(x) at the profile's points
        self.stage: Stage | None = None

    def learn(self, rows: Rows) -> bool:
        """Process messages; returns whether the scene must be redrawn."""
        before = dict(self.shapes)
        for row in rows:
            count, tendon = int(row["sections"]), int(row["tendon"])
            length, radius = row["section_length"][:count], row["section_radius"][:count]
            if count == 0 or not length.sum() > 0:
                continue
            shape = Shape(int(row["joint"]), tuple(length.tolist()), tuple(radius.tolist()))
            self.shapes[tendon] = shape
            K = float(row["effective_friction"])
            self.friction[tendon] = compute_friction_profile(length, radius, K, PROFILE_POINTS)
        if self.shapes == before:
            return False
        self.stage = build_stage(self.shapes, self._config)
        return True

    @property
    def joints(self) -> tuple[int, ...]:
        """The joints that have a sheath."""
        return tuple(sorted({shape.joint for shape in self.shapes.values()}))

    def tendons_of(self, joint: int) -> list[int]:
        """Return the tendons of a joint, `a` first."""
        return sorted(t for t, shape in self.shapes.items() if shape.joint == joint)

    def name(self, tendon: int) -> str:
        """Return the name of a tendon: joint and side (1a, 1b, 2a, ...)."""
        shape = self.shapes.get(tendon)
        if shape is None:
            return f"{tendon + 1}"
        return f"{shape.joint + 1}{'ab'[self.tendons_of(shape.joint).index(tendon) % 2]}"
