"""A GenICam camera through the package `harvesters` and the GenTL producer of its manufacturer.

The interface is that of harvesters 1.4 (`harvesters.core`): `Harvester.add_file`, `update`,
`create`; of the acquirer `start`, `try_fetch`, `stop`, `destroy` and `remote_device.node_map`. The
names of the features (`TriggerSoftware`, `ExposureTime`, `Gain`, `PixelFormat`) are those of the
Standard Features Naming Convention of GenICam.
"""

from __future__ import annotations

import contextlib
import importlib
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from daq.errors import DeviceError

FEATURES = {"width": "Width", "height": "Height", "exposure": "ExposureTime", "gain": "Gain"}
"""Features of the settings of a rig file; the exposure is in microseconds."""
FORMAT = "Mono8"
TRIGGER = (
    ("TriggerSelector", "FrameStart"),
    ("TriggerMode", "On"),
    ("TriggerSource", "Software"),
)


class GenicamCamera:
    """A camera that takes a picture when it is asked to, by its software trigger.

    Args:
        serial: serial number of the camera.
        producer: file of the GenTL producer (.cti).
        settings: width, height, exposure (us) and gain; set before the first picture.
        package: stands in for `harvesters.core`; None loads it.

    Attributes:
        applied: what the camera reports of the settings.

    Raises:
        DeviceError: the package or the producer is missing, there is no such camera, or it does not
            take a setting.
    """

    def __init__(
        self,
        serial: str,
        producer: str,
        settings: Mapping[str, float] | None = None,
        package: Any = None,
    ) -> None:
        self.name = f"camera genicam:{serial}"
        self._acquirer: Any = None
        self._harvester = (package or self._load()).Harvester()
        try:
            self._acquirer = self._open(serial, producer)
            self.applied = self._set(settings or {})
            self._acquirer.start()
        except DeviceError:
            self.close()
            raise
        except Exception as error:  # of a compiled library: it has no common base class
            self.close()
            raise DeviceError(
                self.name, f"cannot be opened: {_words(error)}", "check its cable and the producer"
            ) from None

    def _load(self) -> Any:
        try:
            from harvesters import core
        except ImportError as error:
            raise DeviceError(
                self.name,
                f"needs the package harvesters ({error})",
                "install it with: pip install 'pamrig[genicam]'",
            ) from None
        return core

    def _open(self, serial: str, producer: str) -> Any:
        try:
            self._harvester.add_file(producer, check_existence=True)
        except Exception as error:
            raise DeviceError(
                self.name,
                f"the GenTL producer {producer} cannot be loaded: {_words(error)}",
                "give the .cti file of the camera's manufacturer in camera.gentl",
            ) from None
        self._harvester.update()
        known = [str(info.serial_number) for info in self._harvester.device_info_list]
        if serial not in known:
            found = ", ".join(known) or "none"
            raise DeviceError(
                self.name, f"no such camera; found: {found}", "check its cable and camera.source"
            )
        return self._harvester.create({"serial_number": serial})

    def _set(self, settings: Mapping[str, float]) -> dict[str, float]:
        """Grey pictures on a software trigger, then the settings; what the camera reports."""
        nodes = self._acquirer.remote_device.node_map
        self._write(nodes, "PixelFormat", FORMAT)
        for feature, word in TRIGGER:
            self._write(nodes, feature, word)
        applied: dict[str, float] = {}
        for name, value in settings.items():
            feature = FEATURES[name]
            whole = name in ("width", "height")
            self._write(nodes, feature, round(value) if whole else float(value))
            applied[name] = float(getattr(nodes, feature).value)
            if abs(applied[name] - value) > max(0.01 * abs(value), 0.5):
                raise DeviceError(
                    self.name,
                    f"does not take camera.settings.{name} = {value:g}: it reports "
                    f"{applied[name]:g}",
                    "use a value that the camera offers, or remove the key",
                )
        return applied

    def _write(self, nodes: Any, feature: str, value: Any) -> None:
        try:
            getattr(nodes, feature).value = value
        except Exception as error:
            raise DeviceError(
                self.name, f"does not take {feature} = {value}: {_words(error)}", "see its manual"
            ) from None

    def request(self) -> None:
        """Throw away pictures that were not fetched, and begin a new one.

        Raises:
            DeviceError: the camera is lost.
        """
        try:
            while self.fetch(0.0) is not None:
                pass
            self._acquirer.remote_device.node_map.TriggerSoftware.execute()
        except DeviceError:
            raise
        except Exception as error:
            raise self._lost(error) from None

    def fetch(self, timeout_s: float) -> npt.NDArray[np.uint8] | None:
        """The picture (h, w) that was requested; None if it has not come within the time.

        Raises:
            DeviceError: the camera is lost, or sends another format.
        """
        try:
            buffer = self._acquirer.try_fetch(timeout=timeout_s)
            if buffer is None:
                return None
            try:
                component = buffer.payload.components[0]
                form, data = str(component.data_format), component.data
                shape = int(component.height), int(component.width)
                gray = None if form != FORMAT or data is None else np.array(data)
            finally:
                buffer.queue()
        except Exception as error:
            raise self._lost(error) from None
        if gray is None or gray.size != shape[0] * shape[1]:
            raise DeviceError(self.name, f"sends {form} instead of whole pictures in {FORMAT}")
        return gray.reshape(shape).astype(np.uint8, copy=False)

    def _lost(self, error: Exception) -> DeviceError:
        return DeviceError(
            self.name, f"gives no picture: {_words(error)}", "check its cable; start the run again"
        )

    def close(self) -> None:
        """Stop and release the camera; may be called twice."""
        acquirer, self._acquirer = self._acquirer, None
        for end in ("stop", "destroy"):
            if acquirer is not None:
                with contextlib.suppress(Exception):  # gone already
                    getattr(acquirer, end)()
        with contextlib.suppress(Exception):
            self._harvester.reset()


def found_cameras(producer: str, package: Any = None) -> list[tuple[str, str]]:
    """(serial number, model) of each camera that a GenTL producer sees; none is opened.

    Raises:
        DeviceError: the package or the producer is missing.
    """
    name = "camera genicam"
    try:
        harvester = (package or importlib.import_module("harvesters.core")).Harvester()
        try:
            harvester.add_file(producer, check_existence=True)
            harvester.update()
            return [
                (str(info.serial_number), str(getattr(info, "model", "")))
                for info in harvester.device_info_list
            ]
        finally:
            harvester.reset()
    except Exception as error:  # of a compiled library: it has no common base class
        raise DeviceError(
            name, f"no cameras through {producer}: {_words(error)}", "check package and producer"
        ) from None


def _words(error: Exception) -> str:
    text = " ".join(str(error).split())
    return text[:200] or type(error).__name__
