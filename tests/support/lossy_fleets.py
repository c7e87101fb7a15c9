"""Fleet files with faults, to be changed by tests."""

from pathlib import Path

from dcf_zenoh.config import load

TARGET = """
[faults]                   # every directed link; one table per kind, so --set faults.loss.probability=0.2 works
latency = { distribution = "uniform", low = 0.0002, high = 0.0008 }   # s

[[faults.rule]]            # later rules win, kind by kind
from = 2
to = 3
bursts = { mean_loss = 0.2, mean_length = 4 }                   # Gilbert-Elliott: 20 %, 4 messages in a row

[[faults.rule]]
during = [4.0, 4.5]        # s
partition = [[1, 2], [3, 4]]
"""

BEARS_LOSS = "controller.sharing=piggyback"  # otherwise a note on loss is added

# Third-party faults: one that reads a file, one that names agents, one that loses nothing and refuses a link.
MINE = '''
from dcf_zenoh.faults.fault import Fault, Stage

class Dull(Fault):
    """Nothing happens."""
    LOSES = False
    def __init__(self, sender, receiver, folder, *, often: int = 1, times: float | None = None):
        self.link, self.folder, self.often = (sender, receiver), folder, often
        if often > 9 and receiver == 3:
            raise ValueError(f"often must be at most 9, not {often}")
        if often < 0:
            raise KeyError("oops")
    def apply(self, delivery, rng):
        return (delivery,)

class Told(Dull):
    FILES = ("story",)
    def __init__(self, folder, *, story: str = "", pace: float = 1.0):
        self.text = (folder / story).read_text()

class Jammer(Dull):
    AGENTS = ("victims",)
    STAGE = Stage.CUT
    LOSES = True
    NEEDS_POSITIONS = True
    def __init__(self, *, victims: list[list[int]]): pass

class Keyless(Dull):
    def __init__(self): pass

def wrong(*, often: int = 1):
    return "no fault"
'''


def lossy(folder: Path, faults: str = TARGET, topology: str = "ring") -> Path:
    """The built-in fleet of four on a ring with a time-out of rounds, and `faults`; next to it ``mine.py``."""
    text = Path(load("position_swap").source).read_text(encoding="utf-8")
    for old, new in (
        ('kind = "complete"', f'kind = "{topology}"'),
        ("max_rounds = 200", "max_rounds = 40\nround_timeout = 0.003"),
    ):
        assert old in text
        text = text.replace(old, new)
    (folder / "mine.py").write_text(MINE, encoding="utf-8")
    (folder / "lossy.toml").write_text(text + faults, encoding="utf-8")
    return folder / "lossy.toml"
