# ruff: noqa
# main.py of the emulated board: the simulated board of the firmware, asked over UART1.
# Request: command, milliseconds, length (2 bytes), data. Answer: length (2 bytes), data.
import machine
from valvefw.deskboard import DeskBoard

uart = machine.UART(
    1, 115200, tx=machine.Pin(4), rx=machine.Pin(5), txbuf=4096, rxbuf=1024, timeout=2000
)


def read(n):
    out = b""
    while len(out) < n:
        out += uart.read(n - len(out)) or b""
    return out


def run():
    board = None
    uart.write(b"!")
    while True:
        command, ms, low, high = read(4)
        data = read(low | high << 8)
        if command == 0:
            board = None
            board = DeskBoard(data[0] | data[1] << 8)
            out = b""
        elif ms:
            out = board.run(ms, data)
        else:
            board.feed(data)
            out = b""
        uart.write(bytes((len(out) & 255, len(out) >> 8)))
        uart.write(out)


run()
