"""Parsers that do what hostile files make parsers do; they run in the child of `data_schemas.storage._array_files`."""

import os
import signal
import time

import numpy as np

from data_schemas import ImportFormatError


def whole(content, where):
    """A parser that works: the bytes, and its process."""
    return {"pid": os.getpid(), "where": where}, {"a b/c": np.frombuffer(content, np.uint8), "d": np.eye(3)}


def refusing(content, where):
    raise ImportFormatError(f"{where}: holds {content.decode()}")


def crashing(content, where):
    os.kill(os.getpid(), signal.SIGSEGV)


def hanging(content, where):
    time.sleep(600)


def filling(content, where):
    return len(b"\1" * (4 << 30)), {}
