"""What ptxas says of kernels, as the benchmark reads it."""

from benchmarks.registers import _rows

TEXT = """\
ptxas info    : 0 bytes gmem
ptxas info    : Compiling entry function 'place_blocks_aa59c9c3_cuda_kernel_forward' for 'sm_90'
ptxas info    : Function properties for place_blocks_aa59c9c3_cuda_kernel_forward
    0 bytes stack frame, 0 bytes spill stores, 0 bytes spill loads
ptxas info    : Used 40 registers, used 0 barriers, 1024 bytes smem
ptxas info    : Compiling entry function 'merge_63c6cc0b_cuda_kernel_forward' for 'sm_90'
    96 bytes stack frame, 88 bytes spill stores, 104 bytes spill loads
ptxas info    : Used 255 registers, used 0 barriers, 1024 bytes smem
"""


def test_registers_and_what_is_kept_in_memory_are_read_for_each_kernel():
    assert list(_rows("module", TEXT)) == [
        {"module": "module", "kernel": "place_blocks", "registers": 40, "spilled": 0},
        {"module": "module", "kernel": "merge", "registers": 255, "spilled": 88},
    ]
