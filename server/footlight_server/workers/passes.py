"""How the samples of a progressive render are cut into passes over the image, and passes into slices of tiles."""

from dataclasses import dataclass

# [samples per pixel] A pass doubles what is there, up to this, so that every tile is refreshed while one watches.
LONGEST_PASS = 32
# [s] How long a slice lasts that is watched: short at first, then longer, since the threads wait at its end.
FIRST_SLICE = 0.05
LONGEST_SLICE = 0.5
# [1] Of the time rendered so far.
SLICE_SHARE = 0.1


@dataclass(slots=True)
class Pace:
    """Measures slices and sizes the next pass and the next slice."""

    # [s] Wall time of one sample of each pixel of one tile; 0 until known.
    seconds_per_tile_sample: float = 0.0

    def saw(self, tiles: int, samples: int, seconds: float) -> None:
        """Take in what a slice took. New ones count half: parts of an image differ, and the machine has other work."""
        measured = seconds / (tiles * samples)
        known = self.seconds_per_tile_sample
        self.seconds_per_tile_sample = measured if known == 0 else 0.5 * (known + measured)

    def slice_tiles(self, seconds: float, samples: int, threads: int) -> int:
        """Tiles in the next slice, for it to last `seconds`. One a thread to begin with."""
        if self.seconds_per_tile_sample == 0:
            return threads
        fitting = seconds / (self.seconds_per_tile_sample * samples)
        return max(threads, int(fitting))

    def pass_samples(self, done: int, spp: int, seconds: float, threads: int) -> int:
        """Samples per pixel of the next pass, when `done` of `spp` are in.

        One, three, then as many again; fewer if one tile for each thread would take more than the `seconds` of a slice.
        """
        samples = min(3 if done == 1 else max(done, 1), LONGEST_PASS, spp - done)
        if self.seconds_per_tile_sample > 0:
            fitting = seconds / (self.seconds_per_tile_sample * threads)
            samples = min(samples, max(1, int(fitting)))
        return samples

    def samples_within(self, seconds: float, tiles: int) -> int:
        """Samples per pixel of the whole image that fit into a time."""
        if self.seconds_per_tile_sample == 0:
            return 1
        return int(seconds / (self.seconds_per_tile_sample * tiles))


def slice_seconds(elapsed: float) -> float:
    """[s] How long a slice that is watched shall last, so long after the first began."""
    return min(max(FIRST_SLICE, SLICE_SHARE * elapsed), LONGEST_SLICE)
