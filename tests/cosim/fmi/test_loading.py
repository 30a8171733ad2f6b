"""Loading an FMU, for which fmpy changes the working directory, next to calls in other threads."""

import threading
from pathlib import Path

import fmpy.fmi1

from cosim.fmi.fmu import Fmu, Log, free
from cosim.fmi.isolation import calling


def test_calls_that_begin_during_loading_leave_the_working_directory(
    motor_fmu, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    load, fmu = fmpy.fmi1.cdll.LoadLibrary, Fmu(motor_fmu)
    loading, called, loaded = (threading.Event() for _ in range(3))

    def slow(path: str) -> object:
        assert Path.cwd() != tmp_path
        loading.set()
        assert called.wait(10)
        return load(path)

    def call() -> None:
        assert loading.wait(10)
        with calling("a test"):
            called.set()
            assert loaded.wait(10)

    monkeypatch.setattr(fmpy.fmi1.cdll, "LoadLibrary", slow)
    thread = threading.Thread(target=call)
    thread.start()
    slave = fmu.load("motor", Log())
    loaded.set()
    thread.join()
    free(slave)
    assert Path.cwd() == tmp_path
