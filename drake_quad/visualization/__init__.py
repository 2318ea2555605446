"""Figures, drawings and replays: flights, plans, studies, designs and diagrams."""
