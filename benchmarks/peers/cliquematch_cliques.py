"""cliquematch: all cliques of the correspondence graph by its C++ enumeration, `all_cliques`."""

import cliquematch
import numpy as np
from correspondence import clique_solver
from question import Peer


def cliques(matrix: np.ndarray, size: int) -> list[list[int]]:
    """All of one size; cliquematch counts nodes from 1."""
    graph = cliquematch.Graph.from_matrix(matrix)
    return [[node - 1 for node in clique] for clique in graph.all_cliques(size)]


PEER = Peer(lambda models: clique_solver(cliques, models), ("cliquematch", "numpy", "shapely"))
