"""Records into a file until it is killed, and says after each ping how many are written."""

import sys

import numpy as np

from ertis_driver.chirp import DEFAULT_CHIRP
from ertis_driver.frame import PdmFrame
from ertis_driver.recording import RecordingInfo, RecordingWriter

NUM_WORDS = 163_840


def words_of(index):
    """Words that tell which ping they are of."""
    return np.arange(NUM_WORDS, dtype=np.uint32) * np.uint32(2 * index + 1)


def main():
    path, compress = sys.argv[1], sys.argv[2] == "compressed"
    info = RecordingInfo("sim", DEFAULT_CHIRP, NUM_WORDS)
    with RecordingWriter(path, info, compress=compress) as writer:
        for index in range(100_000):
            frame = PdmFrame(words_of(index), index, index)
            writer.write(frame)
            sys.stdout.write(f"{index + 1}\n")
            sys.stdout.flush()
            writer.write_event(b'{"landmarks": []}', index)


if __name__ == "__main__":
    main()
