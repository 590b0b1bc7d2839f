"""Innovations that wait to be asked for: whoever asks with little room gets the oldest first, and none twice."""

import numpy as np
from in_c import in_c

from imud.estimators.pending_innovations import move_innovations, store_innovation
from imud.estimators.records import INNOVATION, PENDING_INNOVATIONS, PENDING_MAX

store_innovation, move_innovations = in_c(store_innovation), in_c(move_innovations)


def test_the_oldest_come_first_and_the_rest_waits():
    pending, room = np.zeros(1, PENDING_INNOVATIONS), np.zeros(3, INNOVATION)
    for t_ns in range(5):
        store_innovation(pending[0], t_ns, 0, 0.5, 1.0, 1)
    assert move_innovations(pending[0], room) == 3
    assert list(room["t_ns"]) == [0, 1, 2]
    assert move_innovations(pending[0], room) == 2
    assert list(room["t_ns"][:2]) == [3, 4]
    assert move_innovations(pending[0], room) == 0


def test_what_nobody_asks_for_does_not_overflow():
    pending, room = np.zeros(1, PENDING_INNOVATIONS), np.zeros(PENDING_MAX, INNOVATION)
    for t_ns in range(PENDING_MAX + 3):
        store_innovation(pending[0], t_ns, 0, 0.5, 1.0, 1)
    assert move_innovations(pending[0], room) == PENDING_MAX
    assert room["t_ns"][-1] == PENDING_MAX - 1
