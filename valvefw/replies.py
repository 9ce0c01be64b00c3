"""Text of replies, written into a buffer that is made once."""

from valvefw.native import micropython, ptr8


@micropython.viper
def put_text(out: ptr8, at: int, text: ptr8, n: int) -> int:
    """Copy ``n`` bytes of ``text``; returns the place behind them."""
    k = 0
    while k < n:
        out[at + k] = text[k]
        k += 1
    return at + n


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
    if k != at:
        j = 0
        while j < n:
            out[at + j] = out[k + j]
            j += 1
    return at + n
