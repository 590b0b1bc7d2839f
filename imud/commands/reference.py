"""`imud reference`: settings, commands and records as sample file, table, man page or C header.

It is generated from the code that defines them, so it cannot become outdated.
"""

import argparse
import json
import sys
from collections.abc import Callable
from typing import get_type_hints

from .. import client
from ..configuration.schema import is_table, keys
from ..configuration.settings import Settings
from ..estimators import registry

_EXAMPLE_PORTS = ("/dev/ttyUSB0", "/dev/ttyACM0")


def titles() -> dict[str, str]:
    """The title of each table."""
    hints = get_type_hints(Settings)
    return {name: hint.__doc__ or "" for name, hint in hints.items() if is_table(hint)}


def sample(ports: list[str] | None = None) -> str:
    """A configuration file with every key at its default, commented out; with `ports` set if given."""
    lines = [
        "# imud: every setting with its default. Take the # away from what you change.",
        "# (hot) takes effect on `systemctl reload`, the others at the next start.",
    ]
    table = ""
    for key in keys():
        if key.table != table:
            table = key.table
            lines += ["", f"[{table}]  # {titles()[table].rstrip('.')}"]
        lines += ["", f"# {key.what} {key.kind[0].upper()}{key.kind[1:]}.{' (hot)' * key.hot}"]
        if key.path == "ports":
            chosen = f"ports = {json.dumps(ports or _EXAMPLE_PORTS)}"
            lines.append(chosen if ports else f"# {chosen}")
        else:
            lines.append(f"# {key.name} = {key.value}")
    return "\n".join(lines) + "\n"


def table() -> str:
    """Markdown."""
    rows = [
        f"| `{key.path}` | {_cell(key.kind)} | `{key.value}` | {'✓' * key.hot} | {_cell(key.what)} |" for key in keys()
    ]
    return "\n".join(["| key | value | default | hot | |", "|---|---|---|---|---|", *rows]) + "\n"


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def tuning() -> str:
    """Markdown: every tunable of every estimator."""
    rows = [
        f"| `{estimator.table}.tuning.{t.name}` | {_cell(t.kind)} | `{t.default:g}` | {t.unit} | {_cell(t.meaning)} | "
        f"{_cell(t.source)} |"
        for estimator in map(registry.by_name, registry.NAMES)
        for t in estimator.tunables
    ]
    head = ["| key | value | default | unit | meaning | source of the default |", "|---|---|---|---|---|---|"]
    return "\n".join([*head, *rows]) + "\n"


def man_configuration() -> str:
    """imud.toml(5)."""
    lines = [
        '.TH IMUD.TOML 5 "" imud',
        ".SH NAME",
        "imud.toml \\- configuration of the inertial sensor daemon",
        ".SH SYNOPSIS",
        ".I /etc/imud/NAME.toml",
        ".SH DESCRIPTION",
        "TOML. Keys carry their units. A key marked hot takes effect on SIGHUP, any other at the next start.",
        "A file with an error changes nothing; all errors are reported at once.",
    ]
    table = None
    for key in keys():
        if key.table != table:
            table = key.table
            lines.append(f".SH {f'[{table}] ' + titles()[table].rstrip('.').upper() if table else 'TOP LEVEL'}")
        hot = ", hot" if key.hot else ""
        lines += [".TP", f".B {_roff(key.name)}", _roff(f"{key.what} ({key.kind}; default {key.value}{hot})")]
    return "\n".join([*lines, ".SH SEE ALSO", ".BR imud (1)"]) + "\n"


def man_command() -> str:
    """imud(1)."""
    from . import COMMANDS, arguments_of

    lines = [
        '.TH IMUD 1 "" imud',
        ".SH NAME",
        "imud \\- attitude, velocity and position from an inertial sensor and a satellite receiver",
        ".SH SYNOPSIS",
        ".B imud\n[\\fICOMMAND\\fR] [\\fIOPTIONS\\fR]",
        ".SH COMMANDS",
    ]
    for name, summary in COMMANDS.items():
        lines += [".SS " + f"imud {_roff(name)}", _roff(summary[0].upper() + summary[1:]) + "."]
        for action in arguments_of(name)._actions:
            if action.help != argparse.SUPPRESS and action.dest != "help":
                lines += [".TP", f".B {_roff(_option(action))}", _roff((action.help or "") % vars(action))]
    codes = (
        "0 ok, 1 failure, 64 usage, 65 bad data file, 66 input missing, 69 no device, 73 cannot create output, "
        "74 input or output, 77 permission, 78 configuration, 130 Ctrl-C"
    )
    return "\n".join([*lines, ".SH EXIT STATUS", codes, ".SH SEE ALSO", ".BR imud.toml (5)"]) + "\n"


def _option(action: argparse.Action) -> str:
    value = action.metavar or "|".join(action.choices or ()) or (action.dest.upper() if action.nargs != 0 else "")
    return " ".join(filter(None, (", ".join(action.option_strings), str(value))))


def _roff(text: str) -> str:
    """Plain text for troff; a leading dot would be a request."""
    escaped = text.replace("\\", "\\\\").replace("-", "\\-")
    return "\\&" + escaped if escaped.startswith((".", "'")) else escaped


def c_header() -> str:
    """The binary stream and the shared memory for C."""
    bits = [f"#define IMUD_{name} {bit}" for name, bit in client.STATUS.items()]
    fields = []
    for name, kind, count, what in client.FIELDS:
        array = f"[{count}]" if count > 1 else ""
        fields.append(f"    {kind} {name}{array}; /* {what} */")
    return _HEADER.format(
        bits="\n".join(bits),
        fields="\n".join(fields),
        version=client.VERSION,
        size=client.RECORD.size,
        shared_size=client.SHARED_SIZE,
        stale_ns=client.STALE_NS,
    )


_HEADER = """\
/* States of imud, little-endian, as `imud reference c` printed them. SI units, radians, NED, body FRD.
 *
 * stream.listen: a SOCK_SEQPACKET Unix socket; each message is one struct imud_state. Send a uint32_t divisor to
 * get one of so many. shared_memory.path: map it, and read by imud_read(). Where the file was removed, as with the
 * folder that it was in, the next daemon makes another: if imud_read() gives nothing for long, map it again. */
#ifndef IMUD_H
#define IMUD_H
#if defined __STRICT_ANSI__ && !defined _POSIX_C_SOURCE /* for clock_gettime; then include this file first */
#define _POSIX_C_SOURCE 200809L
#endif
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

#define IMUD_VERSION {version}
#define IMUD_STALE_NS {stale_ns}
{bits}

struct imud_state {{
{fields}
}};

struct imud_shared {{
    uint64_t lock; /* 0 before the first state, odd while one is written */
    struct imud_state state;
    uint64_t check; /* exclusive or of the state's 64-bit words */
    int64_t heartbeat_ns; /* when the daemon wrote its last heartbeat, on CLOCK_MONOTONIC */
    uint64_t pid; /* of the daemon */
    uint8_t boot_id[16]; /* of the machine's boot in which it ran */
}};

_Static_assert(sizeof(struct imud_state) == {size}, "layout");
_Static_assert(sizeof(struct imud_shared) == {shared_size}, "layout");

/* This boot's id; 0 where it cannot be read. Each thread reads it once. */
static inline int imud_boot_id(uint8_t boot_id[16])
{{
    static _Thread_local uint8_t known[16];
    static _Thread_local int digits;
    FILE *file = digits < 32 ? fopen("/proc/sys/kernel/random/boot_id", "r") : NULL;
    for (int c; file && digits < 32 && (c = getc(file)) != EOF;) {{
        int digit = c >= '0' && c <= '9' ? c - '0' : c >= 'a' && c <= 'f' ? c - 'a' + 10 : -1;
        if (digit >= 0) {{
            known[digits / 2] = (uint8_t)(known[digits / 2] << 4 | digit);
            digits++;
        }}
    }}
    if (file)
        fclose(file);
    memcpy(boot_id, known, 16);
    return digits == 32;
}}

/* Whether the daemon runs: 0 if it crashed, was killed or is stopped, and the state is an old one, and of a daemon in
 * another time namespace. */
static inline int imud_alive(const volatile struct imud_shared *shared)
{{
    struct timespec now;
    uint8_t boot_id[16];
    clock_gettime(CLOCK_MONOTONIC, &now);
    int64_t now_ns = (int64_t)now.tv_sec * 1000000000 + now.tv_nsec, heartbeat_ns = shared->heartbeat_ns;
    return heartbeat_ns > now_ns - IMUD_STALE_NS && heartbeat_ns < now_ns + IMUD_STALE_NS && imud_boot_id(boot_id)
        && memcmp(boot_id, (const void *)shared->boot_id, 16) == 0;
}}

/* Copies the newest state; 0 if there is none yet, the daemon does not run, or it is at work: try again. */
static inline int imud_read(const volatile struct imud_shared *shared, struct imud_state *state)
{{
    uint64_t lock = __atomic_load_n(&shared->lock, __ATOMIC_ACQUIRE);
    if (lock == 0 || lock & 1)
        return 0;
    memcpy(state, (const void *)&shared->state, sizeof *state);
    __atomic_thread_fence(__ATOMIC_ACQUIRE);
    return __atomic_load_n(&shared->lock, __ATOMIC_RELAXED) == lock && imud_alive(shared);
}}
#endif
"""

FORMS: dict[str, tuple[Callable[[], str], str]] = {
    "toml": (sample, "a sample file (default)"),
    "markdown": (table, "a table"),
    "tuning": (tuning, "a table of the estimators' constants"),
    "man1": (man_command, "the man page of the command"),
    "man5": (man_configuration, "and of the settings"),
    "c": (c_header, "a C header for the stream and the shared memory"),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    forms = "; ".join(f"{form}: {what}" for form, (_, what) in FORMS.items())
    parser.add_argument("form", nargs="?", choices=FORMS, default="toml", metavar="FORM", help=forms)


def run(args: argparse.Namespace) -> int:
    make, _ = FORMS[args.form]
    sys.stdout.write(make())
    return 0
