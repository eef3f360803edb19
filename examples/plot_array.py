"""Plot what an array reads, live: python plot_array.py RIG.toml FINGER, or with a session's folder"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt

import palpate


def main(source: str, finger: str) -> None:
    recorded = Path(source).is_dir()
    watch = palpate.open_session(source).watch if recorded else palpate.open_rig(source).watch
    plt.ion()
    _, axes = plt.subplots()
    with watch([finger]) as monitor:
        image = axes.imshow(monitor.views()[0].taxel_n, origin="lower", vmin=0.0, vmax=0.2)
        for (view,) in monitor.updates(0.1):
            image.set_data(view.taxel_n)
            axes.set_title(f"{view.name}: {view.force_n or 0.0:.2f} N")
            plt.pause(0.001)


if __name__ == "__main__":
    main(*sys.argv[1:3])
