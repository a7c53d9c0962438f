"""What GPUs can do at best: the constants that times are put beside."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["CARDS", "H200", "LAUNCH_SECONDS", "Card", "card_of"]

# The least time from one kernel of a captured graph to the next that waits for it, on any of these cards: an estimate
# (no card was at hand), which the probe of `python -m benchmarks device` measures.
LAUNCH_SECONDS = 1.3e-6


@dataclass(frozen=True)
class Card:
    """A kind of GPU.

    Attributes:
        name: part of the name that CUDA gives it.
        bytes_per_second: of its memory, reading and writing together, from its datasheet or as ``source`` says.
        flops_per_second: float32 operations without tensor cores, from its datasheet.
        source: where the bandwidth comes from.
    """

    name: str
    bytes_per_second: float
    flops_per_second: float
    source: str = "datasheet"

    @property
    def limits(self) -> str:
        """Its constants in words."""
        return (
            f"{self.name}: {self.bytes_per_second / 1e12:.2f} TB/s ({self.source}), "
            f"{self.flops_per_second / 1e12:.0f} Tflop/s, {LAUNCH_SECONDS * 1e6:.1f} us a launch"
        )


H200 = Card("H200", 4.3e12, 67.0e12, "a copy; datasheet 4.8")

# The first whose name is part of the device's: special forms before general ones.
CARDS = (
    Card("B200", 8.0e12, 75.0e12),
    H200,
    Card("H100 NVL", 3.9e12, 60.0e12),
    Card("H100 PCIe", 2.0e12, 51.0e12),
    Card("H100", 3.35e12, 67.0e12),
    Card("A100-SXM4-40GB", 1.555e12, 19.5e12),
    Card("A100-PCIE-40GB", 1.555e12, 19.5e12),
    Card("A100", 1.935e12, 19.5e12),
    Card("L40S", 0.864e12, 91.6e12),
    Card("L40", 0.864e12, 90.5e12),
    Card("L4", 0.3e12, 30.3e12),
    Card("A40", 0.696e12, 37.4e12),
    Card("A10", 0.6e12, 31.2e12),
    Card("RTX 5090", 1.792e12, 104.8e12),
    Card("RTX 4090", 1.008e12, 82.6e12),
    Card("RTX 3090", 0.936e12, 35.6e12),
)


def card_of(device_name: str) -> Card | None:
    """The constants for a device by the name that CUDA gives it; None for one that is not in the list."""
    return next((card for card in CARDS if card.name.lower() in device_name.lower()), None)
