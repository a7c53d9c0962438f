"""Operations of a CPU one after another, as long as a number says so: launches, copies and jumps without the host.

A table has a row for each operation, with the addresses of what it works on (:mod:`warpqem.runtime.native_programs`).
"""

from typing import Any

import warp as wp

wp.set_module_options({"enable_backward": False})  # no gradients are taken

# Numbers of a row.
ROW = 6
# What an operation does, the first number of its row; the others are its arguments.
LAUNCH = 0  # code, bounds, arguments of the kernel, where its threads are counted, or 0
COPY = 1  # target, source, bytes of an item, items, where these are counted, or 0: each of these is so many
ZERO = 2  # target, bytes
SCAN = 3  # target, source, items, where these are counted, or 0, whether each is in its own sum
SKIP = 4  # where a number is that is 0 when rows are skipped, how many


@wp.func_native("""
#if !defined(__CUDA_ARCH__)
    const wp::int64* table = operations.data;
    for (int i = 0; i < operations.shape[0]; ++i) {
        const wp::int64* row = table + 6 * i;
        if (row[0] == 0) {
            // What a launch on a CPU begins with: extents of one axis, and their product.
            if (row[4] != 0) {
                const unsigned threads = *reinterpret_cast<const unsigned*>(row[4]);
                *reinterpret_cast<unsigned*>(row[2]) = threads;
                *reinterpret_cast<size_t*>(row[2] + 8) = threads;
            }
            reinterpret_cast<void (*)(void*, void*)>(row[1])(
                reinterpret_cast<void*>(row[2]), reinterpret_cast<void*>(row[3]));
        } else if (row[0] == 1) {
            size_t bytes = row[3] * row[4];
            if (row[5] != 0) {
                bytes *= *reinterpret_cast<const unsigned*>(row[5]);
            }
            __builtin_memcpy(reinterpret_cast<void*>(row[1]), reinterpret_cast<const void*>(row[2]), bytes);
        } else if (row[0] == 2) {
            __builtin_memset(reinterpret_cast<void*>(row[1]), 0, row[2]);
        } else if (row[0] == 3) {
            int* target = reinterpret_cast<int*>(row[1]);
            const int* source = reinterpret_cast<const int*>(row[2]);
            const int count = row[4] != 0 ? *reinterpret_cast<const int*>(row[4]) : row[3];
            int sum = 0;
            for (int k = 0; k < count; ++k) {
                const int value = source[k];
                target[k] = row[5] != 0 ? sum + value : sum;
                sum += value;
            }
        } else if (*reinterpret_cast<const int*>(row[1]) == 0) {
            i += row[2];
        }
    }
#endif
""")
def run_operations(operations: Any):
    """All rows of a table (n, 6), in order."""
    ...


@wp.kernel
def repeat_operations(
    # in
    operations: wp.array2d[wp.int64],
    # in and out
    running: wp.array[wp.int32],
):
    """Run a table of operations again and again as long as ``running`` (1,), which they change, is not 0."""
    while running[0] != 0:
        run_operations(operations)
