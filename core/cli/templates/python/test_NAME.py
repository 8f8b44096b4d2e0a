import unittest

import numpy as np
from panoscope.testing import Node

from {{lib}} import Filter


class FilterTest(unittest.TestCase):
    def test_pictures_are_brightened(self):
        picture = np.full((2, 3, 3), 100, np.uint8)
        node = Node(Filter, gain=1.5)
        np.testing.assert_array_equal(node(image=picture), np.full((2, 3, 3), 150, np.uint8))
        node.set(gain=3.0)
        np.testing.assert_array_equal(node(image=picture), np.full((2, 3, 3), 255, np.uint8))


if __name__ == "__main__":
    unittest.main()
