/* Gives files to a fuzzer's harness, one after the other: for compilers that have no fuzzer. */
#include <stdint.h>
#include <stdio.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int main(int count, char **names)
{
    static uint8_t data[4096];
    int k;

    for (k = 1; k < count; ++k) {
        FILE *file = fopen(names[k], "rb");
        size_t size;

        if (file == NULL) {
            return 2;
        }
        size = fread(data, 1U, sizeof data, file);
        (void)fclose(file);
        (void)LLVMFuzzerTestOneInput(data, size);
    }
    printf("%d inputs\n", count - 1);
    return 0;
}
