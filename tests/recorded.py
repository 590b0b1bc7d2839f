"""What recordings hold, for tests of other things than their format."""

from imud.drivers.capture import Capture, Raw, Reads


def reads_of(path, port=None):
    """What was read from a port, or from all of them, in its order."""
    read = [item for entry in Capture(path) for item in entry.reads() or ()]
    return [raw for number, raw in read if port in (None, number)]


def message(t_ns, data, port=0):
    """One read, as a message on the topic READS."""
    return Reads.of([(port, Raw(t_ns, data))]).encode()


def stored(path, table):
    """The rows of a table in a recording."""
    entries = [entry for entry in Capture(path) if entry.topic == table.topic]
    return table.read(entries[0].schema if entries else table.schema.name, [entry.data for entry in entries])
