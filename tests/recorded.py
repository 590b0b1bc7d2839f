"""What recordings hold, for tests of other things than their format."""

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

from imud.configuration.settings import Initial
from imud.drivers.capture import Capture
from imud.drivers.capture_messages import Raw, Reads
from imud.recording.player import Handlers, Player
from imud.recording.source import adapter


def reads_of(path, port=None):
    """What was read from a port, or from all of them, in its order."""
    read = [item for entry in Capture(path) for item in entry.reads() or ()]
    return [raw for number, raw in read if port in (None, number)]


def message(t_ns, data, port=0):
    """One read, as a message on the topic READS."""
    return Reads.of([(port, Raw(t_ns, data))]).encode()


def replayed(recording):
    """The estimates of a recording without fixes."""
    steps, adapt = [], adapter(None, (), None)
    player = Player(recording.settings(adapt), adapt, Initial(), Handlers(lambda _, rows: steps.append(rows.copy())))
    for entry in recording:
        player.take(entry)
    return np.concatenate(steps)


def stored(path, table):
    """The rows of a table in a recording."""
    entries = [entry for entry in Capture(path) if entry.topic == table.topic]
    return table.read(entries[0].schema if entries else table.schema.name, [entry.data for entry in entries])


def decoded(name, description, message):
    """A message in Protocol Buffers, decoded by Google's own implementation. description: a FileDescriptorSet."""
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(description).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(name)).FromString(message)
