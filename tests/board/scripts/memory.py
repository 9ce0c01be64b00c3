# ruff: noqa
# main.py of the emulated board: the loop of valvefw.boards.pico.run, and gc.mem_alloc() on request.
import gc

import machine
from valvefw.boards import pico, rp2040
from valvefw.controller import Controller

ANSWER = 0x4005800C  # scratch registers of the watchdog
COMMAND = 0x40058010


def run():
    mem32 = machine.mem32
    mem32[COMMAND] = 0
    board = pico.Pico(rp2040)
    controller = Controller(board, pico._core)
    board.start()
    while True:
        command = mem32[COMMAND]
        if command:
            mem32[COMMAND] = 0
            if command == 1:
                gc.collect()
            mem32[ANSWER] = gc.mem_alloc()
        if not controller.loop():
            machine.idle()


run()
