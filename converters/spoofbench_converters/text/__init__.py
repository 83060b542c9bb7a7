"""Delimited text, shared by converters: lines and records in bounded memory, cells as numbers and
words, and an account of every byte.
"""
