"""The examples under the help of each command. Tests run them on the shipped scenes."""

from __future__ import annotations

__all__ = ["EXAMPLES", "epilog"]

EXAMPLES = {
    "simplify": (
        "warpqem simplify quadruped_gallop.usdc -o out.usdc --ratio 0.1 --report out.html",
        "warpqem simplify cape_wind.usdc -o cape.usda --max-error 0.2 --lock-borders",
        "warpqem simplify cape_wind.usdc -o far.usda --screen-error 1 --distance 10",
        "warpqem simplify cape_wind.usdc -o levels.usda --lods 0.5,0.2,0.05",
    ),
    "batch": (
        "warpqem batch 'talking*.usdc' cape_wind.usdc -o small --ratio 0.2 --jobs 1 --json results.jsonl",
        "warpqem batch 'talking*.usdc' cape_wind.usdc -o small --ratio 0.2 --resume",
    ),
    "info": ("warpqem info talking_head.usdc",),
    "compare": ("warpqem compare cape_wind.usdc cape.usda --heatmap heat.usdc --report compare.html",),
    "features": ("warpqem features quadruped_gallop.usdc -o joints.usda",),
    "render": ("warpqem render cape.usda -o sheet.png --reference cape_wind.usdc --heatmap --pictures 3",),
    "view": ("warpqem view cape_wind.usdc cape.usda",),
    "build": ("warpqem progressive build cape_wind.usdc -o cape.wpqm",),
    "extract": ("warpqem progressive extract cape.wpqm -o level.usda --faces 700",),
    "progressive info": ("warpqem progressive info cape.wpqm",),
    "face detect": ("warpqem face detect talking_head.usdc -o points.json --picture points.png",),
    "face simplify": (
        "warpqem face simplify talking_head.usdc -o head_2000.usda --faces 2000",
        "warpqem face simplify talking_head.usdc -o head_620.usda --faces 620 --points points.json --ring 2",
    ),
    "face retarget": ("warpqem face retarget talking_head.usdc head_2000.usda -o talking_2000.usdc",),
}


def epilog(command: str) -> str:
    """What stands under the help of a command."""
    examples = EXAMPLES[command]
    # A blank line keeps each on a line of its own.
    return "\n\n".join((f"Example{'s' if len(examples) > 1 else ''}:", *examples))
