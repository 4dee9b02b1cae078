"""What tests see of a camera's film by WebRTC, on the page."""

IS_FILM = "!document.querySelector('#picture video').hidden && document.querySelector('#picture img').hidden"
# Of each picture of the film, once it is on the screen: the time since it was drawn, in ms, from the clock in it; its width;
# the age that the page tells, in ms; and the clock: `film`.
FILM = """
window.film = [];
const video = document.querySelector('#picture video');
const drawn = () => {
  video.requestVideoFrameCallback(drawn);
  requestAnimationFrame(() => {
    const [width, height] = [video.videoWidth, video.videoHeight];
    const clock_ms = clock_of(video, width, height), told_s = parseFloat(document.querySelector('#picture output').textContent);
    film.push([Date.now() % 2 ** 40 - clock_ms, width, 1000 * told_s, clock_ms]);
  });
};
video.requestVideoFrameCallback(drawn);
"""
