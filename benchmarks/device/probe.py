"""What the driver can do, in the terms of Warp: captures, loops and branches on the device, memory pool, bandwidth."""

import gc
import time
from collections.abc import Callable

import numpy as np
import warp as wp

from benchmarks.cards import LAUNCH_SECONDS, card_of
from benchmarks.device.findings import Findings
from benchmarks.machine import describe_machine

__all__ = ["run"]

wp.set_module_options({"enable_backward": False})  # no gradients are taken

COPY_BYTES, QUICK_COPY_BYTES, COPIES = 2**28, 2**20, 20
NODES, TURNS, WIDE_BODY = 1000, 1000, 25
SORTED = 1024
# Below this part of the datasheet's bandwidth the card is shared, throttled or not the one that it says it is.
MIN_BANDWIDTH = 0.6


@wp.kernel
def add_one(counter: wp.array[wp.int32]):
    counter[0] = counter[0] + 1


@wp.kernel
def go_on(counter: wp.array[wp.int32], turns: wp.int32, condition: wp.array[wp.int32]):
    counter[0] = counter[0] + 1
    condition[0] = wp.where(counter[0] < turns, 1, 0)


@wp.kernel
def fill_descending(keys: wp.array[wp.int32], values: wp.array[wp.int32]):
    i = wp.tid()
    keys[i] = SORTED - i
    values[i] = i


def run(found: Findings) -> None:
    """Every ability by itself: one that is missing is named, and the next is tried."""
    found.machine(describe_machine(["warpqem"]))
    device = wp.get_device(found.device)
    _facts(found, device)
    for name, check in CHECKS.items():
        try:
            check(found, device)
        except Exception as error:  # whatever a driver that cannot do it makes of it
            found.expect(name, f"{type(error).__name__}: {' '.join(str(error).split())}", "works", False)


def _facts(found: Findings, device: wp.Device) -> None:
    """What the device says of itself."""
    text = f"{device.name}, {device.total_memory / 2**30:.0f} GiB" if device.is_cuda else "a CPU"
    if device.is_cuda:
        driver, toolkit = (
            ".".join(map(str, version or ("?",)))
            for version in (wp.get_cuda_driver_version(), wp.get_cuda_toolkit_version())
        )
        text += f", sm_{device.arch}, driver for CUDA {driver}, Warp's {toolkit}"
    found.measured("device", text)


def _pool(found: Findings, device: wp.Device) -> None:
    if not device.is_cuda:
        found.left_out("memory pool", "a CPU has none")
        return
    enabled = wp.is_mempool_enabled(device)
    if enabled:
        before = wp.get_mempool_release_threshold(device)
        wp.set_mempool_release_threshold(device, 1.0)
        kept = wp.get_mempool_release_threshold(device)
        enabled = kept > 0
        text = f"on; gave memory back above {before} bytes, set to {kept / 2**30:.0f} GiB"
    else:
        text = "off"
    found.expect("memory pool", text, "on, threshold can be set", enabled)


def _copy(found: Findings, device: wp.Device) -> None:
    size = QUICK_COPY_BYTES if found.settings.quick else COPY_BYTES
    source, target = (wp.zeros(size // 4, dtype=wp.int32, device=device) for _ in range(2))
    seconds = _timed(lambda: [wp.copy(target, source) for _ in range(COPIES)], device)
    rate = 2 * size * COPIES / seconds
    card = card_of(device.name)
    text = f"{rate / 1e12:.2f} TB/s read and written"
    if card is None:
        found.measured("copy within the device", text, rate)
    else:
        least = MIN_BANDWIDTH * card.bytes_per_second
        found.expect("copy within the device", text, f"at least {least / 1e12:.2f} TB/s ({card.limits})", rate >= least)


def _graph(found: Findings, device: wp.Device) -> None:
    counter = wp.zeros(1, dtype=wp.int32, device=device)
    wp.launch(add_one, dim=1, inputs=[counter], device=device)
    with wp.ScopedCapture(device=device) as capture:
        for _ in range(NODES):
            wp.launch(add_one, dim=1, inputs=[counter], device=device)
    seconds = _timed(lambda: wp.capture_launch(capture.graph), device)
    count = int(counter.numpy()[0])
    text = f"counted to {count}, {1e6 * seconds / NODES:.2f} us a kernel"
    expected = f"{1 + 2 * NODES}; near {LAUNCH_SECONDS * 1e6:.1f} us"
    found.expect(f"graph of {NODES} kernels", text, expected, count == 1 + 2 * NODES, seconds / NODES)


def _loop(found: Findings, device: wp.Device) -> None:
    for width in (1, WIDE_BODY):
        counter, other, condition = (wp.zeros(1, dtype=wp.int32, device=device) for _ in range(3))

        def body(
            counter: wp.array = counter, other: wp.array = other, condition: wp.array = condition, width: int = width
        ) -> None:
            for _ in range(width - 1):
                wp.launch(add_one, dim=1, inputs=[other], device=device)
            wp.launch(go_on, dim=1, inputs=[counter, TURNS], outputs=[condition], device=device)

        body()
        graph = _captured(lambda body=body, condition=condition: wp.capture_while(condition, body), device)

        def again(counter: wp.array = counter, condition: wp.array = condition, graph: wp.Graph = graph) -> None:
            counter.zero_()
            condition.fill_(1)
            wp.capture_launch(graph)

        seconds = _timed(again, device)
        count = int(counter.numpy()[0])
        text = f"{count} turns, {1e6 * seconds / TURNS:.1f} us each"
        expected = f"{TURNS}; near {4 + LAUNCH_SECONDS * 1e6 * (width - 1):.0f} us"
        found.expect(f"loop on the device, {width} kernels", text, expected, count == TURNS, seconds / TURNS)


def _nested(found: Findings, device: wp.Device) -> None:
    """A body with all that one of warpqem's may hold: kernel, memset, copy to pinned memory, a branch with a sort."""
    turns = 5
    counter, condition, status = (wp.zeros(1, dtype=wp.int32, device=device) for _ in range(3))
    seen = wp.zeros(1, dtype=wp.int32, device="cpu", pinned=device.is_cuda)
    keys, values = (wp.zeros(2 * SORTED, dtype=wp.int32, device=device) for _ in range(2))

    def sort() -> None:
        wp.launch(fill_descending, dim=SORTED, inputs=[keys, values], device=device)
        wp.utils.radix_sort_pairs(keys, values, SORTED)

    def body() -> None:
        status.zero_()
        wp.launch(go_on, dim=1, inputs=[counter, turns], outputs=[condition], device=device)
        wp.copy(seen, counter)
        wp.capture_if(condition, sort)

    condition.fill_(1)
    sort()
    body()
    graph = _captured(lambda: wp.capture_while(condition, body), device)
    counter.zero_()
    condition.fill_(1)
    keys.zero_()
    wp.capture_launch(graph)
    wp.synchronize_device(device)
    right = int(seen.numpy()[0]) == turns and np.array_equal(keys.numpy()[:SORTED], np.arange(1, SORTED + 1))
    text = f"{int(seen.numpy()[0])} turns seen on the host, keys {'sorted' if right else 'not sorted'}"
    found.expect("memset, pinned copy, branch and sort in a loop", text, f"{turns}, sorted", right)


def _scan(found: Findings, device: wp.Device) -> None:
    """``array_scan`` allocates: a loop's body must not on a GPU, and Warp says so."""
    counter, condition = (wp.zeros(1, dtype=wp.int32, device=device) for _ in range(2))
    source, target = (wp.ones(64, dtype=wp.int32, device=device) for _ in range(2))

    def body() -> None:
        wp.utils.array_scan(source, target)
        wp.launch(go_on, dim=1, inputs=[counter, 2], outputs=[condition], device=device)

    body()
    try:
        _captured(lambda: wp.capture_while(condition, body), device)
        text = "allowed"
    except Exception as error:  # RuntimeError in Warp 1.19
        text = f"refused: {' '.join(str(error).split())[:80]}"
    found.measured("allocation in a loop's body", text)


def _captured(record: Callable[[], object], device: wp.Device) -> wp.Graph:
    """A graph of what ``record`` does; nothing is freed meanwhile, which would become part of it."""
    if device.is_cuda and not wp.is_conditional_graph_supported():
        raise RuntimeError("no conditional nodes: the driver is older than CUDA 12.4")
    wp.synchronize_device(device)
    gc.disable()
    try:
        with wp.ScopedCapture(device=device) as capture:
            record()
    finally:
        gc.enable()
    return capture.graph


def _timed(work: Callable[[], object], device: wp.Device) -> float:
    """Seconds of the second of two runs."""
    seconds = 0.0
    for _ in range(2):
        wp.synchronize_device(device)
        start = time.perf_counter()
        work()
        wp.synchronize_device(device)
        seconds = time.perf_counter() - start
    return seconds


CHECKS: dict[str, Callable[[Findings, wp.Device], None]] = {
    "memory pool": _pool,
    "copy within the device": _copy,
    "graph": _graph,
    "loop on the device": _loop,
    "memset, pinned copy, branch and sort in a loop": _nested,
    "allocation in a loop's body": _scan,
}
