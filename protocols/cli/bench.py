"""`musebot bench`: measures the speed."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

from .shared_options import option


@dataclasses.dataclass
class BenchCommand:
    """Measure the speed compared with the raw physics, on an idle machine: about 7 minutes."""

    json: Annotated[Path | None, option("FILE", "none")] = None
    """file to write all measured numbers to"""
    figure: Annotated[Path | None, option("FILE", "none")] = None
    """file for a figure of the cost against the number of robots, an .svg, .png or .pdf"""
    car_xml: Annotated[Path | None, option("FILE", "looked for where MuJoCo usually is")] = None
    """path of MuJoCo's model/car/car.xml, to time the original car too"""
    quick: bool = False
    """measure next to nothing, to see that everything works"""
    interfaces: bool = False
    """measure the cost of the Gymnasium interfaces instead"""
    device: Annotated[str | None, option("{cpu,cuda,cuda:N}", "none")] = None
    """measure populations instead, in the kinematic simulator and in MuJoCo Warp on this device"""

    def __call__(self) -> None:
        """Prints Markdown, each section as soon as it is measured."""
        from ..bench import bench

        bench.run(
            self.json, self.figure, self.car_xml, self.quick, self.interfaces, device=self.device
        )
