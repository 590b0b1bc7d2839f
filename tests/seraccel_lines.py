"""What a serial accelerometer sends: docs/protocols.md §3, of which the first line stands in Prasanna's report."""

GOLDEN = b"X=-0.501 Y=-0.007 Z= 0.082\r\n"  # Prasanna, "Output Modes"
SUCCESSOR = b" 0.01\t-0.02\t 1.00\n\r"
RAW = b"0512\t0498\t0760\n\r"
BINARY = b"#\x02\x00\x01\xf2\x02\xf8$"  # the same counts


def raw(counts, end=b"\n"):
    return b"%04d\t%04d\t%04d" % counts + end
