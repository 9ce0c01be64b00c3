"""Machine code where the interpreter can make it; the same source as plain Python elsewhere.

MicroPython's viper emitter knows the decorator and the pointer types by name. Other interpreters
need the names to exist. There the functions run as they stand: every value in them stays below
2**30, so integers of any size give the same results.
"""

from array import array

try:
    import micropython as micropython
    from micropython import const as const

    def words(n):
        """Memory of ``n`` 32-bit integers, 0."""
        return array("i", [0] * n)

    from valvefw.copying import copy as copy

except ImportError:  # CPython

    def words(n):
        """A list: CPython reads it faster than an array."""
        return [0] * n

    def copy(to, at, source, first, n):
        """Copy ``n`` bytes of ``source`` from ``first`` on to ``to`` from ``at`` on."""
        to[at : at + n] = source[first : first + n]

    def const(value):
        """A constant, which MicroPython's compiler inserts where it is used."""
        return value

    class micropython:
        """The decorator without an effect."""

        @staticmethod
        def viper(function):
            """Leave the function as it is."""
            return function

        native = viper


def ptr8(memory):
    """Bytes."""
    return memory


ptr16 = ptr32 = ptr8
