"""Tables and logs as other programs write them: UTF-8 or UTF-16, gzipped; semicolons, tabs, decimal commas, quotes.

A plain table goes through as it is. Of any other table (also one with comments before its header) every line is
rewritten as plain CSV.
"""

import codecs
import contextlib
import functools
import gzip
import io
import itertools
import re
import textwrap
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
from typing import cast

from ..errors import BadDataError, InputMissingError
from ..progress import Progress

_LOOK = 8192  # lines
_BEGINNING, _PIECES = 1 << 16, 8  # bytes, in which the header stands; in how many pieces
_LONGEST_LINE = 1 << 16  # bytes, or characters; the file may be no table, or a small one that unzips to terabytes
_SHOWN = 120  # characters of a header that is not the right one
_GZIP = b"\x1f\x8b"
_SENTENCE = re.compile(r"\$[A-Z]{2}[A-Z0-9]{3},")
_UTF8 = "utf-8-sig"
_UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def first_bytes(path: Path, n: int) -> bytes:
    """At most the first n bytes of a file, to recognise what it is. Raises InputMissingError."""
    try:
        with path.open("rb") as file:
            return file.read(n)
    except FileNotFoundError as error:
        raise InputMissingError(f"{path}: no such file") from error
    except OSError as error:
        raise InputMissingError(f"{path}: cannot be read: {error.strerror}") from error


@dataclass(frozen=True)
class Table:
    """The layout of a table, by the beginning of its file."""

    path: Path
    names: Sequence[str]
    header: int  # number of its line
    first_row: int  # and of the line where data begin
    delimiter: bytes
    encoding: str
    plain: bool  # its lines need not be rewritten

    def column_numbers(self, wanted: Sequence[str]) -> list[int]:
        """Where these columns are. Raises BadDataError."""
        if missing := [name for name in wanted if name not in self.names]:
            where, must, has = f"{self.path} line {self.header}", ", ".join(wanted), ", ".join(self.names)
            must += " (separated by commas, semicolons or tabs)" * (len(self.names) == 1)
            if "\N{REPLACEMENT CHARACTER}" in has or not has.isprintable():
                raise BadDataError(f"{self.path}: not a text, so no table and no NMEA log either")
            seen = textwrap.shorten(has, _SHOWN, placeholder=" …")
            if all(map(_is_number, self.names)):
                raise BadDataError(f"{where}: there is no header; it must name {must}; the line is: {seen}")
            some = f"no column {', '.join(missing)}; " * (len(missing) < len(wanted))
            raise BadDataError(f"{where}: {some}the header must name {must}; it is: {seen}")
        if double := [name for name in wanted if list(self.names).count(name) > 1]:
            raise BadDataError(f"{self.path} line {self.header}: more than one column {', '.join(double)}")
        return [list(self.names).index(name) for name in wanted]

    def lines(self) -> Iterator[bytes]:
        """The rows as plain CSV, with a progress bar; a truncated gzip file just ends early."""
        progress = Progress(self.path.stat().st_size)
        with contextlib.ExitStack() as stack:
            stack.callback(progress.clear)
            yield from self.rows(progress.at)

    def rows(self, advance: Callable[[int], object]) -> Iterator[bytes]:
        """The same without a bar. advance: called now and then with how many bytes of the file have been read."""
        with self.path.open("rb") as raw:
            lines = _decoded(raw, self.encoding, self.plain)
            with contextlib.suppress(EOFError, zlib.error, gzip.BadGzipFile):
                for number, line in enumerate(lines, 1):
                    if number % _LOOK == 0:
                        advance(raw.tell())
                    cut_off = len(line) >= _LONGEST_LINE
                    if cut_off and len(line := line.rstrip(b"\0")) >= _LONGEST_LINE:
                        raise BadDataError(f"{self.path} line {number}: longer than 64 KiB, so no row of a table")
                    if number >= self.first_row:
                        yield line if self.plain else self._rewritten(line)
                    if cut_off:
                        return  # by a loss of power: what follows are zeros

    def _rewritten(self, line: bytes) -> bytes:
        if self.delimiter != b",":
            line = line.replace(b",", b".").replace(self.delimiter, b",")
        return line.replace(b'"', b"")


def table_of(path: Path, wanted: Sequence[str]) -> Table:
    """The table in a file: its header is the first line that names a column of `wanted`, or else the first.

    A line below it with as many cells and no number has the units, which are in the names, too.

    Raises InputMissingError, BadDataError if the file is empty.
    """
    if not (text := _beginning(path)):
        raise BadDataError(f"{path}: the file is empty")
    lines = text.splitlines()
    at = next((i for i, line in enumerate(lines) if set(_names(line, _delimiter(line))) & set(wanted)), 0)
    delimiter = _delimiter(lines[at])
    names = _names(lines[at], delimiter)
    encoding, zipped = _encoding(path), first_bytes(path, 2) == _GZIP
    plain = not zipped and encoding == _UTF8 and delimiter == "," and '"' not in text and "\n" in text
    first = at + 2 + any(_are_units(line, delimiter, len(names)) for line in lines[at + 1 : at + 2])
    return Table(path, names, at + 1, first, delimiter.encode(), encoding, plain)


def is_nmea(path: Path) -> bool:
    """Whether it is a receiver's log, which may begin in the middle of a sentence. Raises InputMissingError."""
    return _SENTENCE.search(_beginning(path)) is not None


def log_lines(path: Path) -> Iterator[bytes]:
    """The lines of a log, unzipped as far as it can be, UTF-16 recoded; long ones in pieces.

    Raises InputMissingError.
    """
    first_bytes(path, 0)
    encoding, ours = ("latin-1", "latin-1") if _encoding(path) == _UTF8 else ("utf-16", "utf-8")  # bytes as they are
    with path.open("rb") as raw, contextlib.suppress(EOFError, zlib.error, gzip.BadGzipFile):
        for line in _text_lines(raw, encoding):
            yield line.encode(ours)


def _beginning(path: Path) -> str:
    first_bytes(path, 0)  # else there is none
    data = b"".join(itertools.islice(_unzipped(path), _PIECES))
    return codecs.getincrementaldecoder(_encoding(path))("replace").decode(data)


def _encoding(path: Path) -> str:
    return "utf-16" if next(_unzipped(path), b"")[:2] in _UTF16 else _UTF8


def _unzipped(path: Path) -> Iterator[bytes]:
    """The file in pieces; each is as large as can be read without waiting; a truncated file just ends early."""
    with path.open("rb") as raw, contextlib.suppress(EOFError, zlib.error, gzip.BadGzipFile):
        file = _source(raw)
        while piece := file.read1(_BEGINNING):
            yield piece


def _source(raw: BufferedReader) -> BufferedReader:
    zipped = raw.read(len(_GZIP)) == _GZIP
    raw.seek(0)
    return cast(BufferedReader, gzip.GzipFile(fileobj=raw)) if zipped else raw


def _delimiter(line: str) -> str:
    return max(",;\t", key=line.count)


def _names(line: str, delimiter: str) -> list[str]:
    return [name.strip().strip('"').lstrip("#").strip() for name in line.split(delimiter)]


def _are_units(line: str, delimiter: str, columns: int) -> bool:
    """Whether a row is whole and says something, but none of it is a number."""
    cells = _names(line, delimiter)
    return len(cells) == columns and any(cells) and not any(_is_number(cell.replace(",", ".")) for cell in cells)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _decoded(raw: BufferedReader, encoding: str, plain: bool) -> Iterator[bytes]:
    if plain:
        return iter(functools.partial(raw.readline, _LONGEST_LINE), b"")
    return (line.encode() for line in _text_lines(raw, encoding))


def _text_lines(raw: BufferedReader, encoding: str) -> Iterator[str]:
    text = io.TextIOWrapper(_source(raw), encoding, "replace")
    return iter(functools.partial(text.readline, _LONGEST_LINE), "")
