"""Recordings of the suites: found or downloaded by recipe, checked, converted into a cache."""

from spoofbench.fetch.cache import CACHE_VARIABLE, MIRROR_VARIABLE, fetch, fetched, is_cached
from spoofbench.fetch.recipe_file import Recipe, names_of, recipe, recipes

__all__ = [
    "CACHE_VARIABLE",
    "MIRROR_VARIABLE",
    "Recipe",
    "fetch",
    "fetched",
    "is_cached",
    "names_of",
    "recipe",
    "recipes",
]
