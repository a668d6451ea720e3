/* Stands in for VBoxHeadless, whose own start insists on the kernel module: it asks VirtualBox's support library to do
   without (flags DRIVERLESS | DRIVERLESS_IEM_ALLOWED) and then runs the library of VBoxHeadless as it is. For tests
   only: it skips VirtualBox's hardening. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdint.h>
#include <stdio.h>

static void *library(const char *path) {
    void *handle = dlopen(path, RTLD_NOW | RTLD_GLOBAL);
    if (!handle) fprintf(stderr, "%s\n", dlerror());
    return handle;
}

int main(int argc, char **argv, char **envp) {
    void *runtime = library("/usr/lib/virtualbox/VBoxRT.so");
    if (!runtime) return 2;
    int (*init)(int, char ***, uint32_t) = dlsym(runtime, "RTR3InitExe");
    int (*support)(uint32_t, void **) = dlsym(runtime, "SUPR3InitEx");
    void *session = 0;
    if (!init || !support) return 2;
    int status = init(argc, &argv, 0);
    if (status >= 0) status = support((1u << 2) | (1u << 3), &session);
    if (status < 0) {
        fprintf(stderr, "VirtualBox's support library: %d\n", status);
        return 2;
    }
    void *headless = library("/usr/lib/virtualbox/VBoxHeadless.so");
    if (!headless) return 2;
    int (*trusted_main)(int, char **, char **) = dlsym(headless, "TrustedMain");
    return trusted_main ? trusted_main(argc, argv, envp) : 2;
}
