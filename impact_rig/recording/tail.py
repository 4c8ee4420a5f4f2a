"""What the open chunk of a recording holds, in a second file beside it: it outlives a killed process.

A chunk cannot be written piece by piece, because it is compressed and checked as a whole. So its messages go to
`run.mcap.tail` as well, an MCAP file of small chunks; it is removed once the chunk itself is written. `recover` reads
both. If the process was killed between writing the chunk and removing the tail, the messages are in both files: the
tail says from where on a chunk makes it superfluous.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from impact_rig.errors import RecordingError
from impact_rig.recording.description import TopicDescription
from impact_rig.recording.mcap_file import McapFile
from impact_rig.recording.provenance import protect

SUFFIX = ".tail"
"""What follows the name of the recording."""
RECORD_NAME = "impact_rig_tail"
FOLLOWS = "follows"
"""Key of that record: size of the recording when its open chunk began [bytes]."""


def tail_of(recording: Path) -> Path:
    """Return where the tail of an MCAP file is, if there is one."""
    return recording.with_name(recording.name + SUFFIX)


class Tail(McapFile):
    """The tail of one chunk.

    Args:
        recording: the MCAP file.
        follows: its size [bytes].
        topics: in the order they were registered there, so that they have the same ids here.
        chunk_bytes: of the recording.

    Raises:
        RecordingError: it exists, or cannot be written.
    """

    def __init__(self, recording: Path, follows: int, topics: Iterable[TopicDescription], chunk_bytes: int) -> None:
        super().__init__(tail_of(recording), compression="none", chunk_bytes=chunk_bytes)
        self.add_metadata(RECORD_NAME, protect({FOLLOWS: str(follows)}))
        for topic in topics:
            self.add_topic(topic)

    def shortage(self) -> str:
        """Return nothing: the recording leaves room for one more chunk, and for much more."""
        return ""

    def secure(self) -> None:
        """Hand the messages since the last call to the operating system.

        Raises:
            RecordingError: they cannot be written.
        """
        self.close_chunk()
        self.commit()

    def remove(self) -> None:
        """Remove the file: the chunk is written.

        Raises:
            RecordingError: it cannot be removed.
        """
        self.close()
        try:
            self.path.unlink(missing_ok=True)
        except OSError as error:
            raise RecordingError(f"{self.path} cannot be removed: {error.strerror}") from error
