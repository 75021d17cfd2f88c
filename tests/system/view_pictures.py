"""What is looked for in pictures of the view's page."""

import numpy as np

from teleop.view.colours import ESTIMATE, HOUSING, PHASES, STATES, TRUTH

APPEARS_S = 240.0  # on a busy machine; a quiet one takes a tenth
LOST = 0xD55E00FF  # of the strip that says that the view is interrupted
# left, top, right, bottom [pixels] of what the experiment layout shows at 1280 by 800
BANNER = (0, 0, 640, 90)
SCENE = (0, 120, 640, 475)
PROFILE = (0, 505, 318, 770)
LOOP = (350, 560, 505, 720)  # without the names of the phases
TENSION = (645, 30, 1130, 225)  # left of the legends
FORCE = (645, 270, 1130, 425)


EACH_VIEW = [  # a box, and a colour that is in it when its view shows the session
    (PROFILE, ESTIMATE),
    (LOOP, PHASES[4]),
    (TENSION, ESTIMATE),
    (TENSION, TRUTH),
    (TENSION, HOUSING),
    (FORCE, ESTIMATE),
    (BANNER, STATES["engaged"]),
]


def rgb(colour):
    return np.array([(colour >> shift) & 0xFF for shift in (24, 16, 8)])


def pixels(picture, box, colour, tolerance=24):
    """Return how many pixels of a box have a colour, near enough."""
    left, top, right, bottom = box
    part = picture[top:bottom, left:right].astype(int)
    return int((np.abs(part - rgb(colour)).max(axis=-1) <= tolerance).sum())


def green(picture):
    """Return how many pixels have the colour of the banner of an engaged session."""
    return pixels(picture, (0, 0, picture.shape[1], picture.shape[0]), STATES["engaged"], 30)


def engaged(picture):
    """Return whether the banner says so: the newest data have arrived."""
    return green(picture) > 0.02 * picture.shape[0] * picture.shape[1]


def is_dark(picture):
    """Return whether most of the page is as dark as the background of the view."""
    return np.median(picture.max(axis=-1)) < 60
