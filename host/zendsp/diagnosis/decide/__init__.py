"""What is claimed (mechanisms, laws, bodies) and how sure it is; the result, and the next
recording.
"""
