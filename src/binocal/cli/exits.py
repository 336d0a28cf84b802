"""What every command shares when it ends: the exit codes, and the rule that a message is one line."""

FINE, FAILED, USAGE, UNUSABLE_INPUT, BELOW_QUALITY, INTERRUPTED = 0, 1, 2, 3, 4, 130

INTERRUPT_TEXT = "interrupted; no file was left half written."


def one_line(text: str) -> str:
    """The text without line breaks, and with what a terminal would take for a command written out."""
    plain = " ".join(str(text).split())
    return "".join(f"\\x{ord(c):02x}" if ord(c) < 32 or 127 <= ord(c) < 160 else c for c in plain)
