"""The benchmark of online learners: tuning with equal effort, and the leaderboard."""
