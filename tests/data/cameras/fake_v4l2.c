/* A V4L2 camera for tests, put before libc by LD_PRELOAD: /dev/video77, YUYV in any size, 50 Hz, grey pictures.
 *
 * Its driver loses buffers 20 and 21, marks buffer 30 as damaged, and after buffer 59 the first connection is unplugged
 * (ENODEV). Gain has at most 100; automatic white balance cannot be switched off. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <poll.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>
#include <fcntl.h>
#include <linux/videodev2.h>

#define BUFFERS 4
#define LENGTH (2 * 2048 * 2048)
#define PERIOD_NS 20000000LL

static int camera = -1, connections;
static struct v4l2_pix_format format;
static struct v4l2_fract interval = {1, 30};
static int queue[BUFFERS], queued;
static unsigned sequence;
static long long began_ns, exposure = 100, gain = 1, manual = 3, white = 1;

static long long now_ns(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * 1000000000LL + t.tv_nsec;
}

static int gone(void) { return connections == 1 && sequence >= 60; }

int open(const char *path, int flags, ...) {
    static int (*real)(const char *, int, ...);
    va_list rest;
    va_start(rest, flags);
    int mode = va_arg(rest, int);
    va_end(rest);
    if (!real) real = dlsym(RTLD_NEXT, "open");
    if (strcmp(path, "/dev/video77")) return real(path, flags, mode);
    camera = real("/dev/null", O_RDWR);
    connections++;
    queued = 0;
    sequence = 0;
    return camera;
}

int close(int fd) {
    static int (*real)(int);
    if (!real) real = dlsym(RTLD_NEXT, "close");
    if (fd == camera) camera = -1;
    return real(fd);
}

static int fail(int error) {
    errno = error;
    return -1;
}

static long long *control(unsigned id) {
    switch (id) {
    case V4L2_CID_EXPOSURE_AUTO: return &manual;
    case V4L2_CID_EXPOSURE_ABSOLUTE: return &exposure;
    case V4L2_CID_GAIN: return &gain;
    case V4L2_CID_AUTO_WHITE_BALANCE: return &white;
    default: return NULL;
    }
}

static void complete(struct v4l2_format *f) {
    f->fmt.pix.pixelformat = V4L2_PIX_FMT_YUYV;
    f->fmt.pix.field = V4L2_FIELD_NONE;
    f->fmt.pix.bytesperline = 2 * f->fmt.pix.width;
    f->fmt.pix.sizeimage = f->fmt.pix.bytesperline * f->fmt.pix.height;
    f->fmt.pix.colorspace = V4L2_COLORSPACE_SRGB;
    format = f->fmt.pix;
}

static int dequeue(struct v4l2_buffer *b) {
    if (gone()) return fail(ENODEV);
    if (!queued) return fail(EAGAIN);
    if (sequence == 20) sequence = 22;
    long long ns = began_ns + sequence * PERIOD_NS;
    b->index = queue[0];
    memmove(queue, queue + 1, --queued * sizeof *queue);
    b->bytesused = format.sizeimage;
    b->sequence = sequence;
    b->timestamp.tv_sec = ns / 1000000000;
    b->timestamp.tv_usec = ns % 1000000000 / 1000;
    b->flags = V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC | V4L2_BUF_FLAG_TSTAMP_SRC_SOE;
    if (sequence == 30) b->flags |= V4L2_BUF_FLAG_ERROR;
    sequence++;
    return 0;
}

static int camera_ioctl(unsigned request, void *p) {
    switch (request) {
    case VIDIOC_QUERYCAP: {
        struct v4l2_capability *c = p;
        strcpy((char *)c->card, "Fake");
        c->device_caps = V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING;
        return 0;
    }
    case VIDIOC_ENUM_FMT: {
        struct v4l2_fmtdesc *d = p;
        if (d->index > 1) return fail(EINVAL);
        d->pixelformat = d->index ? V4L2_PIX_FMT_YUYV : V4L2_PIX_FMT_GREY;
        return 0;
    }
    case VIDIOC_S_FMT: complete(p); return 0;
    case VIDIOC_G_FMT: ((struct v4l2_format *)p)->fmt.pix = format; return 0;
    case VIDIOC_S_PARM: interval = ((struct v4l2_streamparm *)p)->parm.capture.timeperframe; return 0;
    case VIDIOC_G_PARM: ((struct v4l2_streamparm *)p)->parm.capture.timeperframe = interval; return 0;
    case VIDIOC_QUERY_EXT_CTRL: {
        struct v4l2_query_ext_ctrl *q = p;
        q->type = q->id == V4L2_CID_AUTO_WHITE_BALANCE ? V4L2_CTRL_TYPE_BOOLEAN : V4L2_CTRL_TYPE_INTEGER;
        return control(q->id) ? 0 : fail(EINVAL);
    }
    case VIDIOC_G_EXT_CTRLS: {
        struct v4l2_ext_control *c = ((struct v4l2_ext_controls *)p)->controls;
        if (!control(c->id)) return fail(EINVAL);
        c->value = *control(c->id);
        return 0;
    }
    case VIDIOC_S_EXT_CTRLS: {
        struct v4l2_ext_control *c = ((struct v4l2_ext_controls *)p)->controls;
        if (!control(c->id)) return fail(EINVAL);
        if (c->id == V4L2_CID_AUTO_WHITE_BALANCE) return fail(EACCES);
        *control(c->id) = c->id == V4L2_CID_GAIN && c->value > 100 ? 100 : c->value;
        return 0;
    }
    case VIDIOC_REQBUFS:
        if (gone()) return fail(ENODEV);
        if (((struct v4l2_requestbuffers *)p)->count > BUFFERS) ((struct v4l2_requestbuffers *)p)->count = BUFFERS;
        return 0;
    case VIDIOC_QUERYBUF: ((struct v4l2_buffer *)p)->length = LENGTH; return 0;
    case VIDIOC_QBUF: {
        int index = ((struct v4l2_buffer *)p)->index;
        if (gone()) return fail(ENODEV);
        if (index >= BUFFERS) return fail(EINVAL);
        for (int i = 0; i < queued; i++)
            if (queue[i] == index) return fail(EINVAL);
        queue[queued++] = index;
        return 0;
    }
    case VIDIOC_DQBUF: return dequeue(p);
    case VIDIOC_STREAMON: began_ns = now_ns(); return 0;
    case VIDIOC_STREAMOFF: queued = 0; return gone() ? fail(ENODEV) : 0;
    default: return fail(ENOTTY);
    }
}

/* The binding calls ioctl through syscall(). */
long syscall(long number, ...) {
    static long (*real)(long, ...);
    long a[6];
    va_list rest;
    va_start(rest, number);
    for (int i = 0; i < 6; i++) a[i] = va_arg(rest, long);
    va_end(rest);
    if (number == SYS_ioctl && camera >= 0 && (int)a[0] == camera) return camera_ioctl((unsigned)a[1], (void *)a[2]);
    if (!real) real = dlsym(RTLD_NEXT, "syscall");
    return real(number, a[0], a[1], a[2], a[3], a[4], a[5]);
}

void *mmap(void *at, size_t length, int protection, int flags, int fd, off_t offset) {
    static void *(*real)(void *, size_t, int, int, int, off_t);
    if (!real) real = dlsym(RTLD_NEXT, "mmap");
    if (fd < 0 || fd != camera) return real(at, length, protection, flags, fd, offset);
    void *memory = real(NULL, length, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    memset(memory, 128, length);
    return memory;
}

/* Ready when the next picture is due. */
int poll(struct pollfd *fds, nfds_t count, int timeout_ms) {
    static int (*real)(struct pollfd *, nfds_t, int);
    if (!real) real = dlsym(RTLD_NEXT, "poll");
    if (count != 1 || camera < 0 || fds->fd != camera) return real(fds, count, timeout_ms);
    if (gone()) {
        fds->revents = POLLERR | POLLHUP;
        return 1;
    }
    long long wait_ns = began_ns + (sequence + 1) * PERIOD_NS - now_ns();
    long long most_ns = timeout_ms < 0 ? 1000000000LL : timeout_ms * 1000000LL;
    int late = wait_ns > most_ns;
    if (late) wait_ns = most_ns;
    if (wait_ns > 0) usleep(wait_ns / 1000);
    if (late || !queued) return 0;
    fds->revents = POLLIN;
    return 1;
}
