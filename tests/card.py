"""Hardware that a test and a machine share: the shipped pendulum behind a card of 512 words."""

from __future__ import annotations

import mmap
import struct
from pathlib import Path

_OPEN = """
#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>
#define zendsp_machine pendulum_machine
#include "pendulum.c"
#undef zendsp_machine
static volatile long *card;
static int card_open(void **h, const char *c, double p, machine_info *i, char *e, size_t n) {
    const int f = open("%s", O_RDWR);
    card = mmap(0, 4096, PROT_READ | PROT_WRITE, MAP_SHARED, f, 0);
    close(f);
    const int failed = pendulum_machine.open(h, c, p, i, e, n);
    if (HARDWARE) i->simulated = 0;
    return failed;
}
"""


class Card:
    """What the hardware sees, and its machine in C: ``functions`` stand beside ``card_open`` and
    read and write ``card[word]``; ``hardware``: it does not say that it is simulated.
    """

    def __init__(self, folder: Path, functions: str, hardware: bool) -> None:
        self.machine = folder / "guarded.c"
        self.path = path = folder / "card"
        path.write_bytes(bytes(4096))
        with path.open("r+b") as file:
            self._map = mmap.mmap(file.fileno(), 4096)
        self.machine.write_text(f"#define HARDWARE {hardware:d}\n{_OPEN % path}{functions}")

    def __getitem__(self, word: int) -> int:
        return int(struct.unpack_from("q", self._map, 8 * word)[0])

    def __setitem__(self, word: int, value: int) -> None:
        struct.pack_into("q", self._map, 8 * word, value)
