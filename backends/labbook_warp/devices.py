"""Devices by name, without a fall-back to another one."""

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

import warp as wp

from labbook.backend import Device, Survey, Unsupported

wp.config.log_level = wp.LOG_ERROR  # a machine without a GPU is no cause for a warning


def find(name: str):
    """Return the Warp device called `name`.

    Raises:
        Unsupported: it does not exist.
    """
    wp.init()
    available = [device.alias for device in wp.get_devices()]
    if name not in available:
        raise Unsupported("device", device_remedy(name, available))
    return wp.get_device(name)


def device_remedy(name: str, available: Sequence[str]) -> str:
    """Sentence about a missing device `name`, with the remedy; available: the existing ones."""
    state = f"Warp finds {', '.join(available)}" if available else "Warp finds no device"
    if "cpu" not in available and name == "cpu":
        state = f"this build of Warp has no CPU device; {state}"
    elif not any(device.startswith("cuda") for device in available):
        state = "no CUDA device was found"
    device = f", or --device {available[0]}" if available else ""
    return f"there is no device {name} ({state}); use --backend numba, which is faster on a CPU{device}"


def free(device: wp.Device) -> int | None:
    """Free memory of a device in bytes; None for the processor's memory, which is not limited here."""
    if not device.is_cuda:
        return None
    wp.synchronize_device(device)  # memory that was freed returns to the device only then
    return device.free_memory


def shared_with_others() -> bool:
    """True if other programs may use the GPUs of this machine at the same time, by NVIDIA's Multi-Process Service.

    The service runs if its control pipe is in the folder where CUDA itself looks.
    """
    folder = os.environ.get("CUDA_MPS_PIPE_DIRECTORY") or Path(tempfile.gettempdir(), "nvidia-mps")
    return Path(folder, "control").exists()


def survey() -> Survey:
    """Versions of Warp and CUDA, and all devices."""
    wp.init()
    versions = {
        "Warp": wp.config.version,
        "CUDA that Warp was built with": _dotted(wp.get_cuda_toolkit_version()),
        "CUDA that the driver supports": _dotted(wp.get_cuda_driver_version()),
    }
    devices = (Device(d.alias, d.name, d.total_memory if d.is_cuda else None) for d in wp.get_devices())
    return Survey(versions, tuple(devices))


def _dotted(version: tuple[int, int] | None) -> str:
    return ".".join(map(str, version)) if version else "none"
