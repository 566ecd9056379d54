/* A GigE camera that sees what a test wants it to see: in each exposure the grey values that FILE holds at that moment, one byte a pixel, row by
 * row. Whoever moves the mirror puts another file in FILE's place. Aravis has all of a camera but the view; scripts/fake-camera.sh builds and runs
 * this one. */

#include <arv.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

static void see(ArvBuffer *buffer, void *file, guint32 exposure_us, guint32 gain, ArvPixelFormat format)
{
    /* The buffer is the camera's own, so it may be written to; that an image of its size fits, Aravis has seen to. */
    unsigned char *pixels = (unsigned char *)arv_buffer_get_data(buffer, NULL);
    size_t needed = (size_t)arv_buffer_get_image_width(buffer) * (size_t)arv_buffer_get_image_height(buffer);
    FILE *view = fopen(file, "rb");
    (void)exposure_us;
    (void)gain;
    if (view == NULL || format != ARV_PIXEL_FORMAT_MONO_8 || fread(pixels, 1, needed, view) != needed || fgetc(view) != EOF) {
        fprintf(stderr, "%s does not hold %zu grey values of 8 bits\n", (char *)file, needed);
        exit(1);
    }
    fclose(view);
}

int main(int count, char **arguments)
{
    ArvGvFakeCamera *camera;
    if (count != 2) {
        fprintf(stderr, "usage: %s FILE\n", arguments[0]);
        return 2;
    }
    camera = arv_gv_fake_camera_new("127.0.0.1", "UW1");
    if (!arv_gv_fake_camera_is_running(camera)) {
        fprintf(stderr, "the fake camera does not run: is another one at 127.0.0.1?\n");
        return 1;
    }
    arv_fake_camera_set_fill_pattern(arv_gv_fake_camera_get_fake_camera(camera), see, arguments[1]);
    for (;;) {
        pause();
    }
}
