"""The memory of a process that is measured."""

from pathlib import Path


def peak_megabytes() -> float:
    """Peak resident memory of this process [MB].

    Of /proc, where there is one: getrusage counts that of the process it was started from too.
    """
    status = Path("/proc/self/status")
    if not status.exists():
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return float(status.read_text().split("VmHWM:")[1].split()[0]) / 1024.0
