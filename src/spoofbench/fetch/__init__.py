"""Recordings of the suites: found, downloaded or simulated by recipe, checked, converted into a
cache.
"""

from spoofbench.fetch.cache import CACHE_VARIABLE, MIRROR_VARIABLE, cached_path, fetch
from spoofbench.fetch.recipe_file import Recipe, names_of, recipe, recipes

__all__ = [
    "CACHE_VARIABLE",
    "MIRROR_VARIABLE",
    "Recipe",
    "cached_path",
    "fetch",
    "names_of",
    "recipe",
    "recipes",
]
