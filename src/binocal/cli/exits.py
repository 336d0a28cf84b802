"""What every command shares when it ends: the exit codes, and the rule that a message is one line."""

FINE, FAILED, USAGE, UNUSABLE_INPUT, BELOW_QUALITY, INTERRUPTED = 0, 1, 2, 3, 4, 130

INTERRUPT_TEXT = "interrupted; no file was left half written."


def one_line(text: str) -> str:
    """The text without line breaks."""
    return " ".join(str(text).split())
