"""A recording in Rerun's viewer, with the pictures, the points in 3D and the log side by side.

pip install rerun-sdk; python examples/view_in_rerun.py hall.mcap [out.rrd]
"""

import sys
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

# The 3D view stays empty until it is told whose frame it shows.
LAYOUT = rrb.Blueprint(
    rrb.Horizontal(
        rrb.Spatial2DView(origin="/picture", name="what the sonar hears, from above"),
        rrb.Vertical(
            rrb.Spatial3DView(
                name="landmarks, truth and microphones",
                contents=["/detections", "/truth/points", "/microphones", "/tf"],
                spatial_information=rrb.SpatialInformation(target_frame="sonar"),
            ),
            rrb.TextLogView(origin="/log", name="log"),
        ),
    ),
    collapse_panels=True,
)


def main() -> None:
    """Show a recording; with a second name, write it for `rerun FILE` instead."""
    recording = Path(sys.argv[1])
    rr.init("ertis", spawn=len(sys.argv) < 3)
    if len(sys.argv) > 2:
        rr.save(sys.argv[2], default_blueprint=LAYOUT)
    rr.send_blueprint(LAYOUT)
    rr.log_file_from_path(recording)


if __name__ == "__main__":
    main()
