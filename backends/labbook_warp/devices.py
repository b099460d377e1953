"""Finding the device that was asked for; never another one."""

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

import warp as wp

from labbook.backend import Device, Survey, Unsupported

wp.config.log_level = wp.LOG_ERROR  # a machine without a GPU is no cause for a warning


def find(name: str):
    """The Warp device called `name`. Raises Unsupported if it is not there."""
    wp.init()
    here = [device.alias for device in wp.get_devices()]
    if name not in here:
        raise Unsupported("device", device_remedy(name, here))
    return wp.get_device(name)


def device_remedy(name: str, here: Sequence[str]) -> str:
    """What to do where the device `name` is not among those that are `here`."""
    found = f"Warp finds {', '.join(here)}" if here else "Warp finds no device"
    if "cpu" not in here and name == "cpu":
        found = f"this build of Warp has no CPU device; {found}"
    elif not any(device.startswith("cuda") for device in here):
        found = "no CUDA device was found"
    device = f", or --device {here[0]}" if here else ""
    return f"there is no device {name} ({found}); use --backend numba, which is faster on a CPU{device}"


def free(device: wp.Device) -> int | None:
    """Bytes of memory that are free on a device; None for the processor's own memory, which is not rationed."""
    if not device.is_cuda:
        return None
    wp.synchronize_device(device)  # what was let go returns to the device only then
    return device.free_memory


def shared_with_others() -> bool:
    """Whether programs may be on the GPUs of this machine at the same time: NVIDIA's Multi-Process Service is there.

    It is where its control pipe is, in the folder that CUDA itself looks in.
    """
    folder = os.environ.get("CUDA_MPS_PIPE_DIRECTORY") or Path(tempfile.gettempdir(), "nvidia-mps")
    return Path(folder, "control").exists()


def survey() -> Survey:
    """Versions of Warp and CUDA, and every device that Warp finds."""
    wp.init()
    versions = {
        "Warp": wp.config.version,
        "CUDA that Warp was built with": _dotted(wp.get_cuda_toolkit_version()),
        "CUDA that the driver supports": _dotted(wp.get_cuda_driver_version()),
    }
    found = (Device(d.alias, d.name, d.total_memory if d.is_cuda else None) for d in wp.get_devices())
    return Survey(versions, tuple(found))


def _dotted(version: tuple[int, int] | None) -> str:
    return ".".join(map(str, version)) if version else "none"
