"""Draws the pictures on the pages of the tasks, in the working directory."""

from PIL import Image

import musebot

for task, seed, camera in (
    ("wall_avoidance", 5, "corner"),
    ("spot_finding", 5, "corner"),
    ("wall_avoidance_obstacles", 6, "corner"),
    ("spot_finding_two_noses", 3, "follow"),
    ("spot_finding_walls", 7, "corner"),
    ("spot_finding_jumping", 5, "overhead"),
):
    environment = musebot.load("arena", task, task_kwargs={"random": seed})
    environment.reset()
    large = environment.physics.render(720, 1080, camera_id=camera)
    Image.fromarray(large).resize((360, 240), Image.Resampling.BOX).save(f"{task}.png")
