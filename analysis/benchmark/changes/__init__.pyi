from .changes_track import score_changes as score_changes
