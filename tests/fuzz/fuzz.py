"""Fuzzes one target: ``python tests/fuzz/fuzz.py TARGET FOLDER [libFuzzer options]``.

Corpus and failing inputs go to FOLDER; ``... TARGET FOLDER FILE`` runs a failing input again.
"""

import logging
import sys
import tempfile
from pathlib import Path


def main():
    """Fuzz; the exit code is libFuzzer's."""
    import atheris

    # Only what is imported in here gives coverage, and only coverage leads the fuzzer.
    with atheris.instrument_imports(include=["ertis_driver", "mcap", "planted"]):
        import targets
    from seeds import seeds

    logging.disable(logging.CRITICAL)
    target, folder, *options = sys.argv[1:]
    folder = Path(folder)
    corpus = folder / target
    corpus.mkdir(parents=True, exist_ok=True)
    for number, seed in enumerate(seeds(target)):
        (corpus / f"seed-{number}").write_bytes(seed)
    tempfile.tempdir = str(folder)
    again = any(not option.startswith("-") for option in options)
    own = ["-timeout=20", "-rss_limit_mb=2048", f"-artifact_prefix={folder}/{target}-"]
    atheris.Setup(
        [sys.argv[0], *own, *options, *([] if again else [str(corpus)])], targets.TARGETS[target]
    )
    atheris.Fuzz()


if __name__ == "__main__":
    main()
