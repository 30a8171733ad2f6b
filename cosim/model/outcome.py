"""Outcomes of episodes: one enumeration for grid, moves and dynamics, with one precedence."""

from enum import StrEnum


class Outcome(StrEnum):
    """Outcome of an episode, or what became of a robot in it; false while it runs.

    Members are in order of precedence: of two that happen in the same step the later one holds. A
    robot off the board outranks a collision, of the same robot and of others; both outrank the
    rest.
    """

    RUNNING = ""
    TIMEOUT = "timeout"
    SUCCESS = "success"
    COLLISION = "collision"
    OUT_OF_BOARD = "out_of_board"


# For kernels: ranks of the members, and the members by rank.
RUNNING, TIMEOUT, SUCCESS, COLLISION, OUT_OF_BOARD = range(len(Outcome))
BY_RANK = tuple(Outcome)

# Outcomes of episodes that have ended, as reports list them.
ENDS = (Outcome.SUCCESS, Outcome.COLLISION, Outcome.OUT_OF_BOARD, Outcome.TIMEOUT)
