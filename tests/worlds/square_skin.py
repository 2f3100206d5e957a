"""A square skin of the article's size on a mesh coarse enough for tests."""

from softslide.pipeline.sensor import Accelerometer, MeshSize, Sensor


def square_skin(*places_mm: tuple[float, float], size_mm: float = 5.0) -> Sensor:
    """With boards at these places, or one at (5, 0) mm."""
    parts = tuple(Accelerometer(f"a{n}", x, y) for n, (x, y) in enumerate(places_mm or [(5.0, 0.0)]))
    return Sensor("s", 1000.0, (50.0, 50.0), 4.0, 6.0, 0.035, (5.0, 0.0), 5e-4, parts, mesh=MeshSize(size_mm))
