"""Text of replies, written into a buffer that is made once."""

from valvefw.native import copy, micropython, ptr8


@micropython.viper
def put_number(out: ptr8, at: int, low: int, high: int) -> int:
    """Write ``high * 65536 + low`` in decimal; returns the place behind it."""
    end = at + 10
    k = end
    while True:
        rest = high % 10 << 16 | low
        high = high // 10
        low = rest // 10
        k -= 1
        out[k] = 48 + rest % 10
        if high == 0 and low == 0:
            break
    n = end - k
    copy(out, at, out, k, n)
    return at + n
