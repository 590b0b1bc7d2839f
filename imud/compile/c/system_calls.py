"""The functions of the C library that kernels call: integers of 64 bits in and out, on processors of 32 bits, too.

Their definitions come last in a file, behind the headers that they need, whose macros may have the names of a kernel's
variables.
"""

PRELUDE = """#define _GNU_SOURCE
#define _FILE_OFFSET_BITS 64
"""

_HEADERS = ("errno.h", "sys/epoll.h", "sys/socket.h", "sys/timerfd.h", "time.h", "unistd.h")
_BODIES = {  # name -> parameters, statements
    "epoll_wait": (
        "int32_t file, int64_t events, int32_t n, int32_t timeout_ms",
        "return epoll_wait(file, AT(events), n, timeout_ms);",
    ),
    "pwrite": ("int32_t file, int64_t from, int64_t n, int64_t to", "return pwrite(file, AT(from), (size_t)n, to);"),
    "read": ("int32_t file, int64_t to, int64_t n", "return read(file, AT(to), (size_t)n);"),
    "send": ("int32_t file, int64_t from, int64_t n, int32_t flags", "return send(file, AT(from), (size_t)n, flags);"),
    "clock_gettime": (
        "int32_t clock, int64_t to",
        "struct timespec now; int failed = clock_gettime(clock, &now); int64_t *t = AT(to);"
        " t[0] = now.tv_sec; t[1] = now.tv_nsec; return failed;",
    ),
    "timerfd_settime": (
        "int32_t file, int32_t flags, int64_t from, int64_t to",
        "const int64_t *t = AT(from); struct itimerspec at = {{t[0], t[1]}, {t[2], t[3]}};"
        " return timerfd_settime(file, flags, &at, AT(to));",
    ),
    "__errno_location": ("void", "return (int64_t)(intptr_t)&errno;"),
}


def declaration(name: str) -> str:
    """Of the function `system_NAME`. Raises KeyError for a name that has none."""
    return f"static int64_t system_{name}({_BODIES[name][0]});"


def definitions(names: list[str]) -> str:
    """Of these functions, with what they include."""
    if not names:
        return ""
    lines = [f"#include <{header}>" for header in _HEADERS]
    lines.append("#define AT(address) ((void *)(intptr_t)(address))")
    for name in names:
        parameters, statements = _BODIES[name]
        lines.append(f"static int64_t system_{name}({parameters}) {{ {statements} }}")
    return "\n".join(lines) + "\n"
