"""The enumerations of gpiod 2 that an input with edges needs."""

from enum import Enum


class Direction(Enum):
    AS_IS, INPUT, OUTPUT = 1, 2, 3


class Edge(Enum):
    NONE, RISING, FALLING, BOTH = 1, 2, 3, 4


class Clock(Enum):
    MONOTONIC, REALTIME, HTE = 1, 2, 3


class Bias(Enum):
    AS_IS, UNKNOWN, DISABLED, PULL_UP, PULL_DOWN = 1, 2, 3, 4, 5
