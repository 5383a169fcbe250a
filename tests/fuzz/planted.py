"""Proof that the fuzzer is led by coverage: by luck alone it finds this once in 2**32 runs."""


class Found(Exception):
    """The planted branch was reached."""


def check(data):
    """Raise if the data begin with four certain bytes; a branch for each of them."""
    if (
        len(data) > 3
        and data[0] == 0x45
        and data[1] == 0x52
        and data[2] == 0x54
        and data[3] == 0x49
    ):
        raise Found
