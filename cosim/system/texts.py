"""Texts of a system by number, so that compiled code passes them on as it does integers."""


class TextTable:
    """Table of texts, which grows with every other one that an FMU puts out.

    Attributes:
        known: texts by their numbers; 0 is the empty one.
    """

    def __init__(self) -> None:
        self.known = [""]
        self._numbers = {"": 0}

    def number(self, text: str | bytes | None) -> int:
        """Return the number of a text; None, which FMI 2.0 allows, counts as the empty one."""
        text = text.decode() if isinstance(text, bytes) else text or ""
        if text not in self._numbers:
            self._numbers[text] = len(self.known)
            self.known.append(text)
        return self._numbers[text]
