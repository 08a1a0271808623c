"""Network laws judged: by measured delays, and by statistics of what they draw. Above the media, which laws never see."""
