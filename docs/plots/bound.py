"""Draw docs/img/bound.png from docs/bound.csv: best size and detection over signal-to-clutter."""

from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")

import matplotlib.pyplot as plt

from ertis_simulator.bound.table import ARRAY, BEAM, read_sizes

DOCS = Path(__file__).parent.parent
BANDS_DEG = ((0, 15), (20, 35), (40, 60))
COLUMNS = {"level": "size, level known", "free": "size, nothing known", "detected": "detected"}


def main() -> None:
    """Draw."""
    rows = read_sizes(DOCS / "bound.csv")
    figure, axes = plt.subplots(2, 3, figsize=(10, 6), sharex=True, sharey=True)
    for across, (kind, title) in enumerate(((BEAM, "inside one beam"), (ARRAY, "32 microphones"))):
        for column, (name, label) in enumerate(COLUMNS.items()):
            for low, high in BANDS_DEG:
                band = [row for row in rows if row.receiver == kind and low <= row.tilt_deg <= high]
                ratios = sorted({row.ratio_db for row in band})
                share = [
                    np.mean([getattr(r, name) for r in band if r.ratio_db == x]) for x in ratios
                ]
                axes[across, column].plot(ratios, share, "o-", ms=3, label=f"tilt {low}-{high}")
            axes[across, column].set_title(f"{label}; {title}", fontsize=9)
            axes[across, column].grid(alpha=0.3)
        axes[across, 0].set_ylabel("share of pings")
    for axis in axes[1]:
        axis.set_xlabel("signal-to-clutter (dB)")
    axes[0, 0].legend(fontsize=8)
    figure.suptitle("Best possible from one ping, 80-20 kHz (simulated, Gaussian interference)")
    figure.tight_layout()
    figure.savefig(DOCS / "img/bound.png", dpi=90)


if __name__ == "__main__":
    main()
