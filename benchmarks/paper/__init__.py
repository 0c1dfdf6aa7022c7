"""The paper rebuilt on rendered scenes: its methods, its figure 4 and its tables 3 to 9, beside sagnode's.

``python benchmarks/paper/run.py`` measures everything and writes it into ``docs/paper.md``.
"""

from paper.methods import by_paper

__all__ = ["by_paper"]
