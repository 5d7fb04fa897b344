"""The image that a run keeps of each pose for people; calculations use the recording itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.events.grey_image import to_uint8


@dataclass(frozen=True)
class StoredImage:
    """An image for people, 8 bits per pixel, compressed without loss; a run keeps one for each of its poses."""

    png: bytes

    @classmethod
    def from_image(cls, image: NDArray[Any]) -> StoredImage:
        """Stretch the grey values of an image (`calib.events.grey_image.to_uint8`) and compress it.

        image: (H, W), any numeric dtype, grey values.
        """
        return cls(cv2.imencode(".png", to_uint8(image), (cv2.IMWRITE_PNG_COMPRESSION, 1))[1].tobytes())

    def decoded(self) -> NDArray[np.uint8]:
        """Return the image.

        Returns: (H, W) uint8, grey values.
        """
        image = cv2.imdecode(np.frombuffer(self.png, np.uint8), cv2.IMREAD_GRAYSCALE)
        assert image is not None
        return np.asarray(image, np.uint8)
