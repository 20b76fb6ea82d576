"""Images as the workflow looks at them: without the distortion of their lens, where it has any."""

from __future__ import annotations

from functools import lru_cache

import cv2

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.geometry.lens import RadialLens
from roadsight.io.images.exif import decoded_image
from roadsight.io.records.atomic import read_json
from roadsight.poles.drive.drive_lenses import Key, lens_of, with_given
from roadsight.poles.images.views import source_places, straightened
from roadsight.studio.project import SiteFolder

_DRIVE = "poles/drive.json"
_EFFECTS = "effects.json"
_DISTORTION = "lens_distortion"


def lens_for(site: SiteFolder, key: Key) -> RadialLens | None:
    """Lens whose distortion the workflow takes out of a drive's images; None if it does not.

    Parameters
    ----------
    key : route, width and height of the images.
    """
    drive, effects = site.results / _DRIVE, site.results / _EFFECTS
    if not (drive.exists() and effects.exists()):
        return None
    decided = {one["effect"]: one["decision"] for one in read_json(effects)}
    if decided.get(_DISTORTION) != "simulate":
        return None
    given = [lens.model_dump() for lens in site.resolved.site.poles.lenses]
    lenses = with_given(read_json(drive)["lenses"], given)
    return lens_of(lenses, key, (key[2], key[1]))


def without_distortion(content: bytes, lens: RadialLens) -> bytes:
    """An image's file as JPEG, as a pinhole camera would have taken it.

    Raises
    ------
    InputError : it is no image.
    """
    image = decoded_image(content, cv2.IMREAD_COLOR)
    if image is None:
        raise InputError("is no image that can be read", where="picture")
    turned = straightened(image, _places(lens, image.shape[1], image.shape[0]), smooth=True)
    return cv2.imencode(".jpg", turned, [cv2.IMWRITE_JPEG_QUALITY, 90])[1].tobytes()


@lru_cache(maxsize=4)
def _places(lens: RadialLens, width_px: int, height_px: int) -> Floats:
    return source_places(lens, (width_px, height_px), (height_px, width_px))
