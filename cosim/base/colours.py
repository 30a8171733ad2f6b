"""Colours that colour-blind readers tell apart, for figures, recordings and pictures alike."""

# Okabe and Ito's palette.
BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
BLUE, VERMILION, PURPLE = "#0072B2", "#D55E00", "#CC79A7"
GREY = "#808080"
ROBOT_COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)


def robot_colour(robot: int) -> str:
    """Return the colour of a robot and of all that belongs to it, "#RRGGBB"."""
    return ROBOT_COLOURS[robot % len(ROBOT_COLOURS)]


def rgb(colour: str) -> tuple[int, int, int]:
    """Return red, green and blue of a colour, 0 to 255 each."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red, green, blue


def rgba(colour: str) -> int:
    """Return an opaque colour as Rerun takes it, 0xRRGGBBAA."""
    return int(colour[1:], 16) << 8 | 0xFF


def robot_rgba(robot: int) -> int:
    """Return the colour of a robot as Rerun takes it, 0xRRGGBBAA."""
    return rgba(robot_colour(robot))
