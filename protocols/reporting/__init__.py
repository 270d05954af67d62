"""Text and pictures made from results: tables, figures and the report page."""
