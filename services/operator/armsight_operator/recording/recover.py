"""A whole file from what can be read of others."""

from pathlib import Path

from armsight.bus import Sample
from armsight_operator.recording.backlog import Arrival
from armsight_operator.recording.reader import Recording, topic_of
from armsight_operator.recording.series import Limits, Series


def recover(recording: Recording, out: Path, *, overwrite: bool = False) -> int:
    """Writes every readable message to one file; what the recorder had converted is converted anew.

    Returns:
        How many messages.

    Raises:
        ConfigError: the file is there already, or can't be made.
        FullError: no room.
    """
    names = " ".join(str(path) for path in recording.paths)
    series = Series(out, Limits(), {"recovered_from": names}, overwrite=overwrite)
    count = 0
    for entry in recording.entries():
        topic = topic_of(entry.key)
        if entry.converted or topic is None:
            continue
        sample = Sample(topic, topic.name_in(entry.key), entry.payload, b"")
        count += series.write(Arrival(sample, entry.log_ns, entry.sequence)) is not None
    series.finish("recovered", {})
    return count
